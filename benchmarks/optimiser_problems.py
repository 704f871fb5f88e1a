"""Problems on which optimisers are compared: real photographs, and path-traced ones with known parameters, in several scenes."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from benchmarks.common import QUICK_RESOLUTION, SHARED, SHARED_VOLUME, scene_with, tell_progress
from benchmarks.synthetic_photograph import MIDDLE, Truth, draw_truth, photograph_by_path_tracing, photograph_of_opacity
from cloudfit.comparison.problems import PhotographSource, ProblemSource, SceneSource
from cloudfit.fit_types import FitOptions
from cloudfit.photograph import list_photographs
from cloudfit.scene import Scene
from cloudfit.scene_record import describe_scene, load_volume
from render.procedural_cloud import build_cumulus
from render.ray_march import compute_optical_length
from render.units import radians_from_degrees
from render.volume_files import write_volume

REAL = (
    "cumulus_kloofendal_a",
    "cumulus_noon_02",
    "cumulus_picos",
    "altocumulus_evening_a",
    "sunset_beach",
    "storm_over_sea",
)
"""Photographs of the shared data, the most unlike first."""

SUNS = ((220.0, 40.0), (120.0, 20.0))
"""Azimuth and elevation in degrees of the first scene and the others."""

TRACED_WIDTH, TRACED_NOISE, MOST_SAMPLES, FIRST_TRUTH = 320, 0.02, 4096, 5_000


@dataclass(frozen=True)
class NamedScene:
    """A scene, and the ending of the names of its problems."""

    ending: str
    scene: Scene


def benchmark_scenes(arguments: argparse.Namespace, folder: Path, width: int, height: int) -> list[NamedScene]:
    """The volume asked for, or else the shared cloud and the procedural cumulus, each under a sun of its own.

    Args:
        arguments: with `volume` and `quick`.
        folder: for the volume of quick runs.
        width, height: of the cameras.
    """
    if arguments.quick:
        small = folder / "cumulus.npz"
        write_volume(small, build_cumulus(QUICK_RESOLUTION))
        volumes: list[Path | None] = [small]
    elif arguments.volume is not None:
        volumes = [arguments.volume]
    else:
        volumes = [SHARED_VOLUME, None] if SHARED_VOLUME.exists() else [None]
    scenes = []
    for number, volume in enumerate(volumes):
        azimuth, elevation = (radians_from_degrees(angle) for angle in SUNS[min(number, len(SUNS) - 1)])
        scene = scene_with(load_volume(volume), volume, width, height)
        name = "cumulus" if volume is None else volume.stem.partition("_")[0]
        scenes.append(NamedScene(name, replace(scene, sun_azimuth=azimuth, sun_elevation=elevation)))
    return scenes


def real_photographs(folder: Path, count: int) -> list[Path]:
    """The first so many of the shared photographs, or of another folder."""
    if folder == SHARED / "photos":
        return [path for name in REAL[:count] if (path := folder / f"{name}.jpg").exists()]
    return list_photographs([folder])[:count]


def photograph_sources(
    photographs: Sequence[Path], scenes: Sequence[NamedScene], options: FitOptions, tables: Path
) -> list[ProblemSource]:
    """Each photograph in each scene."""
    return [
        PhotographSource(f"{path.stem}-{named.ending}", path, None, _source(named, options, tables))
        for named in scenes
        for path in photographs
    ]


def traced_sources(
    count: int, named: NamedScene, options: FitOptions, tables: Path, folder: Path, quick: bool
) -> list[ProblemSource]:
    """Photographs by the reference path tracer at random parameters, with their masks; quick ones are composed without tracing."""
    sources: list[ProblemSource] = []
    for number in range(count):
        path = folder / f"traced_{number:02d}.png"
        camera = named.scene.camera
        if quick:
            truth = replace(MIDDLE, optical_depth=5.0 + 10.0 * number)
            photograph = photograph_of_opacity(named.scene, camera, truth, path)
        else:
            tell_progress(f"path-traced photograph {number + 1} of {count}")
            camera = camera.resized(TRACED_WIDTH, TRACED_WIDTH * camera.height // camera.width)
            truth = draw_truth(torch.Generator().manual_seed(FIRST_TRUTH + number))
            path.parent.mkdir(parents=True, exist_ok=True)
            photograph = photograph_by_path_tracing(
                named.scene, camera, truth, path, noise=TRACED_NOISE, most_samples=MOST_SAMPLES, seed=number
            )
        mask = path.with_name(f"{path.stem}_mask.png")
        scene = _source(named, options, tables)
        parameters = _parameters(named.scene, photograph.truth)
        sources.append(PhotographSource(f"traced_{number:02d}-{named.ending}", path, mask, scene, parameters))
    return sources


def _parameters(scene: Scene, truth: Truth) -> dict[str, float]:
    """The truth in the units of the search."""
    largest = float(compute_optical_length(scene.grid, *scene.camera.rays()).max())
    return {
        "sunlight_intensity": truth.sunlight_intensity,
        "asymmetry": truth.asymmetry,
        "extinction": truth.optical_depth / largest,
        "albedo": truth.albedo,
        "ambient": truth.ambient,
    }


def _source(named: NamedScene, options: FitOptions, tables: Path) -> SceneSource:
    return SceneSource(describe_scene(named.scene), options, tables)
