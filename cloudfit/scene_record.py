"""A scene as plain numbers in a result file, and the scene that such a record describes."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from cloudfit.scene import Scene
from precompute.store import table_key
from render.camera import Camera, OrthographicCamera, PinholeCamera, Vector, direction_from_angles
from render.density_grid import DensityGrid
from render.errors import CameraError, VolumeError
from render.procedural_cloud import build_cumulus
from render.units import degrees_from_radians, radians_from_degrees
from render.volume_files import read_volume

CUMULUS_RESOLUTION = 128
"""Voxels along the longest side of the procedural cumulus that stands in where no volume is given."""


def volume_hash(grid: DensityGrid) -> str:
    """Hash of the densities and the box of a volume, the same on every machine."""
    return table_key({"density": grid.density, "lower": grid.lower, "upper": grid.upper})


def load_volume(path: Path | None) -> DensityGrid:
    """Volume from a file, or the procedural cumulus without one. Raises VolumeError if it cannot be read."""
    return build_cumulus(CUMULUS_RESOLUTION) if path is None else read_volume(path)


def describe_scene(scene: Scene) -> dict[str, Any]:
    """Everything that is needed to set the scene up again, with units in the names."""
    z, y, x = scene.grid.density.shape
    return {
        "volume": {
            "file": None if scene.volume is None else str(scene.volume.resolve()),
            "sha256": volume_hash(scene.grid),
            "voxels_x": x,
            "voxels_y": y,
            "voxels_z": z,
            "lower_m": scene.grid.lower.tolist(),
            "upper_m": scene.grid.upper.tolist(),
        },
        "camera": describe_camera(scene.camera),
        "sun_azimuth_deg": degrees_from_radians(scene.sun_azimuth),
        "sun_elevation_deg": degrees_from_radians(scene.sun_elevation),
    }


def describe_camera(camera: Camera) -> dict[str, Any]:
    """Every number of a camera.

    Raises:
        CameraError: for a camera of another kind than the two.
    """
    if not isinstance(camera, PinholeCamera | OrthographicCamera):
        raise CameraError(f"expected a pinhole or an orthographic camera, got {type(camera).__name__}")
    common = {
        "position_m": list(camera.position),
        "target_m": list(camera.target),
        "up": list(camera.up),
        "width": camera.width,
        "height": camera.height,
    }
    if isinstance(camera, PinholeCamera):
        return {"type": "pinhole", **common, "field_of_view_deg": degrees_from_radians(camera.field_of_view)}
    return {"type": "orthographic", **common, "view_height_m": camera.view_height}


def camera_from_record(record: Mapping[str, Any]) -> PinholeCamera | OrthographicCamera:
    """Camera that `describe_camera` described.

    Raises:
        CameraError: the record is incomplete or describes no view.
    """
    try:
        position, target, up = (_vector(record[name]) for name in ("position_m", "target_m", "up"))
        width, height = int(record["width"]), int(record["height"])
        if record["type"] == "pinhole":
            field_of_view = radians_from_degrees(float(record["field_of_view_deg"]))
            return PinholeCamera(position, target, field_of_view, width, height, up)
        if record["type"] == "orthographic":
            return OrthographicCamera(position, target, float(record["view_height_m"]), width, height, up)
    except (KeyError, TypeError, ValueError) as error:
        raise CameraError(f"the recorded camera is incomplete: {type(error).__name__} {error}") from error
    raise CameraError(f"expected a camera of type pinhole or orthographic, got {record['type']!r}")


def scene_from_record(record: Mapping[str, Any], volume: Path | None = None) -> Scene:
    """Scene that `describe_scene` described.

    Args:
        record: of the scene.
        volume: file to take instead of the recorded one; it may hold another cloud.

    Raises:
        VolumeError: the volume is gone, or the recorded file holds another one now.
        CameraError: the recorded camera describes no view.
    """
    recorded = record["volume"]["file"]
    path = volume if volume is not None else None if recorded is None else Path(recorded)
    grid = load_volume(path)
    if volume is None and volume_hash(grid) != record["volume"]["sha256"]:
        name = "the procedural cumulus of this version" if path is None else str(path)
        raise VolumeError(f"{name} is not the volume that was fitted; pass the right one with --volume")
    return Scene(
        grid=grid,
        volume=path,
        camera=camera_from_record(record["camera"]),
        sun_azimuth=radians_from_degrees(record["sun_azimuth_deg"]),
        sun_elevation=radians_from_degrees(record["sun_elevation_deg"]),
    )


def turn_camera(
    camera: PinholeCamera | OrthographicCamera,
    azimuth: float | None = None,
    elevation: float | None = None,
    field_of_view: float | None = None,
    distance: float | None = None,
) -> PinholeCamera | OrthographicCamera:
    """The camera moved around its target; whatever is None stays.

    Args:
        camera: to start from.
        azimuth, elevation: direction of view [rad].
        field_of_view: vertical opening angle [rad].
        distance: from the target [m].

    Raises:
        CameraError: a field of view for an orthographic camera, or numbers that describe no view.
    """
    offset = torch.tensor(camera.target, dtype=torch.float64) - torch.tensor(camera.position, dtype=torch.float64)
    length = float(torch.linalg.vector_norm(offset))
    x, y, z = (offset / length).tolist()
    forward = direction_from_angles(
        math.atan2(x, y) if azimuth is None else azimuth,
        math.asin(max(-1.0, min(1.0, z))) if elevation is None else elevation,
    )
    length = length if distance is None else distance
    position = _vector([t - f * length for t, f in zip(camera.target, forward, strict=True)])
    if field_of_view is None:
        return replace(camera, position=position)
    if isinstance(camera, OrthographicCamera):
        raise CameraError("an orthographic camera has no field of view; leave --camera-fov out")
    return replace(camera, position=position, field_of_view=field_of_view)


def _vector(values: Any) -> Vector:
    x, y, z = (float(value) for value in values)
    return (x, y, z)
