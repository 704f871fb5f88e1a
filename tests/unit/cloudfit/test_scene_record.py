import json
import math
from pathlib import Path

import pytest
import torch

from cloudfit.scene import Scene
from cloudfit.scene_record import (
    camera_from_record,
    describe_camera,
    describe_scene,
    scene_from_record,
    turn_camera,
    volume_hash,
)
from render.camera import OrthographicCamera, PinholeCamera, frame_volume
from render.density_grid import DensityGrid
from render.errors import CameraError, VolumeError
from render.volume_files import write_volume

GRID = DensityGrid.from_voxel_size(torch.rand(5, 4, 3, generator=torch.Generator().manual_seed(1)), 10.0)
PINHOLE = frame_volume(GRID, width=20, height=10, azimuth=0.7, elevation=0.2)
ORTHOGRAPHIC = frame_volume(GRID, width=20, height=10, azimuth=0.7, elevation=0.2, orthographic=True)


@pytest.mark.parametrize("camera", [PINHOLE, ORTHOGRAPHIC])
def test_a_camera_comes_back_from_json(camera: PinholeCamera | OrthographicCamera) -> None:
    record = json.loads(json.dumps(describe_camera(camera)))
    back = camera_from_record(record)
    for ours, theirs in zip(camera.rays(), back.rays(), strict=True):
        assert torch.allclose(ours, theirs, atol=1e-6)
    turned = camera_from_record({**record, "position_m": [1.0, 2.0, 3.0]})
    assert not torch.allclose(camera.rays()[0], turned.rays()[0], atol=1e-3)


@pytest.mark.parametrize("change", [{"type": "fisheye"}, {"position_m": [1.0]}, {"width": None}, {"width": 0}])
def test_a_damaged_camera_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(CameraError):
        camera_from_record({**describe_camera(PINHOLE), **change})


def test_a_camera_record_needs_every_number() -> None:
    record = describe_camera(PINHOLE)
    del record["field_of_view_deg"]
    with pytest.raises(CameraError, match="field_of_view_deg"):
        camera_from_record(record)


def test_a_scene_comes_back_with_the_volume_that_was_fitted(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    write_volume(path, GRID)
    record = describe_scene(Scene(GRID, path, PINHOLE, 3.8, 0.6))
    back = scene_from_record(json.loads(json.dumps(record)))
    assert volume_hash(back.grid) == volume_hash(GRID)
    assert (back.sun_azimuth, back.sun_elevation) == pytest.approx((3.8, 0.6))
    other = DensityGrid(GRID.density * 0.5, GRID.lower, GRID.upper)
    write_volume(path, other)
    with pytest.raises(VolumeError, match="not the volume that was fitted"):
        scene_from_record(record)
    assert volume_hash(scene_from_record(record, path).grid) == volume_hash(other)


def test_a_volume_that_is_gone_is_named(tmp_path: Path) -> None:
    record = describe_scene(Scene(GRID, tmp_path / "gone.npz", PINHOLE, 3.8, 0.6))
    with pytest.raises(VolumeError, match=r"gone\.npz"):
        scene_from_record(record)


def test_the_hash_sees_densities_and_box() -> None:
    assert volume_hash(GRID) == volume_hash(DensityGrid(GRID.density.clone(), GRID.lower, GRID.upper))
    assert volume_hash(GRID) != volume_hash(DensityGrid(GRID.density + 1e-6, GRID.lower, GRID.upper))
    assert volume_hash(GRID) != volume_hash(DensityGrid(GRID.density, GRID.lower, GRID.upper + 1.0))


def test_turning_nothing_changes_nothing() -> None:
    assert turn_camera(PINHOLE).position == pytest.approx(PINHOLE.position)


def test_a_camera_turns_around_its_target_at_its_distance() -> None:
    turned = turn_camera(PINHOLE, azimuth=math.pi / 2, elevation=0.0)
    offset = torch.tensor(turned.target) - torch.tensor(turned.position)
    distance = math.dist(PINHOLE.position, PINHOLE.target)
    assert offset.tolist() == pytest.approx([distance, 0.0, 0.0], abs=1e-3)  # azimuth 90 degrees looks east, along x
    assert turned.target == PINHOLE.target
    near = turn_camera(PINHOLE, distance=50.0, field_of_view=1.0)
    assert math.dist(near.position, near.target) == pytest.approx(50.0)
    assert isinstance(near, PinholeCamera)
    assert near.field_of_view == 1.0


def test_parallel_rays_have_no_field_of_view() -> None:
    with pytest.raises(CameraError, match="--camera-fov"):
        turn_camera(ORTHOGRAPHIC, field_of_view=1.0)
