"""How the cost of a frame with shafts of light grows with triangles and lamps, and whether `--tolerance` keeps its word."""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.common import make_table, show, spread
from benchmarks.random_shaft_scenes import SCENES, draw_scene
from benchmarks.shaft_measures import ERROR_COLUMNS, MAPS, QUICK_MAPS, clocked, compute_reference, error_cells, judge
from render.camera import PinholeCamera
from render.shafts.casters import make_ground, make_sphere
from render.shafts.lights import PointLight
from render.shafts.methods import METHODS
from render.shafts.ray_casting import RayCaster
from render.shafts.scene import ShaftScene
from render.shafts.scene_file import load_scene
from render.shafts.stage import MapSettings, prepare_stage
from render.shafts.truth import choose_settings

SPHERE_RINGS = (16, 32, 62, 88, 124, 175, 246, 350, 500)
"""Of spheres of 1 k to 1 M triangles."""

FEW_TRIANGLES = 15_000
"""From which growth is counted (acceptance to 1 M)."""

LAMP_NUMBERS = (1, 2, 4, 8, 16, 32)

TOLERANCE = 0.02

Outcome = tuple[Any, tuple[Table, ...]]


def measure_triangles(arguments: argparse.Namespace) -> Outcome:
    """Seconds of a frame, from meshes to light, for spheres of more and more triangles."""
    base = load_scene("window")
    camera = PinholeCamera((0.0, -6.0, 1.0), (0.0, 0.0, 1.0), 0.8, arguments.width // 2, arguments.height // 2)
    found = []
    for number in SPHERE_RINGS[:2] if arguments.quick else SPHERE_RINGS:
        ball = make_sphere((0.0, 0.0, 1.2), 1.0, number)
        scene = replace(base, camera=camera, meshes=(ball, make_ground(20.0)), reach=40.0)
        found.append({"triangles": len(ball.triangles), **measure_frames(scene, arguments)})
    few = [one for one in found if one["triangles"] >= FEW_TRIANGLES] or found
    growth = total_seconds(few[-1]) / total_seconds(few[0])
    built = [total_seconds(one) + one["build"]["median"] for one in few]
    rows = [
        (f"{one['triangles']:,}", *(show(one[part]) for part in ("build", "ready", "gather")), *error_cells(one))
        for one in found
    ]
    columns = ("triangles", "building once [s]", "maps and depth [s]", "light [s]", *ERROR_COLUMNS)
    title = (
        f"triangles: from {few[0]['triangles']:,} to {few[-1]['triangles']:,} a frame takes {growth:.2f} times as long, "
        f"with building the tree {built[-1] / built[0]:.2f} times"
    )
    return {"frames": found, "growth": growth, "growth_with_building": built[-1] / built[0]}, (
        make_table(title, columns, rows),
    )


def total_seconds(frame: dict[str, Any]) -> float:
    """Median seconds of a frame, the tree of triangles being built already."""
    return float(frame["ready"]["median"] + frame["gather"]["median"])


def measure_frames(scene: ShaftScene, arguments: argparse.Namespace) -> dict[str, Any]:
    """Seconds of building the ray caster, of making ready without that, and of gathering by adaptive marching; errors of the light."""
    build: list[float] = []
    ready: list[float] = []
    gather: list[float] = []
    for _ in range(arguments.repeats):
        begun = time.perf_counter()
        RayCaster(scene.meshes)
        build.append(time.perf_counter() - begun)
        stage = prepare_stage(scene, QUICK_MAPS if arguments.quick else MAPS)
        ready.append(sum(stage.seconds.values()) - stage.seconds["geometry"])
        seconds, light = clocked(METHODS["adaptive"], stage)
        gather.append(seconds)
    errors = judge(light, compute_reference(stage, arguments.truth_change, arguments.whole_truth))
    return {"build": spread(build), "ready": spread(ready), "gather": spread(gather), **errors}


def measure_lamps(arguments: argparse.Namespace) -> Outcome:
    """Seconds of a frame for more and more lamps, and the line that fits them best."""
    base = load_scene("lights").resized(arguments.width // 2, arguments.height // 2)
    found = []
    for number in LAMP_NUMBERS[:3] if arguments.quick else LAMP_NUMBERS:
        lamps = tuple(_lamp(n) for n in range(number))
        found.append({"lamps": number, **measure_frames(replace(base, lights=lamps), arguments)})
    line = fit_line([one["lamps"] for one in found], [total_seconds(one) for one in found])
    rows = [(str(one["lamps"]), show(one["ready"]), show(one["gather"]), *error_cells(one)) for one in found]
    title = f"lamps: {line['slope']:.3g} s for each and {line['offset']:.3g} s, off by {line['residual']:.1%} (RMS)"
    columns = ("lamps", "maps and depth [s]", "light [s]", *ERROR_COLUMNS)
    return {"frames": found, "line": line}, (make_table(title, columns, rows),)


def fit_line(numbers: Sequence[float], seconds: Sequence[float]) -> dict[str, float]:
    """Slope and offset of the least squares of relative deviations, and their root mean square."""
    x, y = np.asarray(numbers, float), np.asarray(seconds, float)
    slope, offset = np.polyfit(x, y, 1, w=1.0 / y)
    residual = float(np.sqrt(np.mean(((slope * x + offset) / y - 1.0) ** 2)))
    return {"slope": float(slope), "offset": float(offset), "residual": residual}


def _lamp(number: int) -> PointLight:
    """Lamps in rows of eight."""
    row, column = divmod(number, 8)
    return PointLight((3.0 * (column - 3.5), 0.5 + 3.0 * row, 2.6), (20.0, 14.0, 8.0))


def measure_tolerance(arguments: argparse.Namespace) -> Outcome:
    """Errors of settings that were chosen for a tolerance on coarse pictures of random scenes."""
    width, height = (48, 27) if arguments.quick else (arguments.width // 3, arguments.height // 3)
    maps = MapSettings(128, 32) if arguments.quick else MapSettings(1024, 128)
    found: list[dict[str, Any]] = []
    for number in range(2 if arguments.quick else SCENES):
        name, scene = draw_scene(number, 0, width, height)
        begun = time.perf_counter()
        chosen = choose_settings(scene, METHODS["auto"], TOLERANCE, maps)
        choosing = time.perf_counter() - begun
        stage = prepare_stage(scene, maps)
        seconds, light = clocked(chosen.method, stage)
        errors = judge(light, compute_reference(stage, arguments.truth_change, arguments.whole_truth))
        found.append(
            {
                "scene": name,
                "refinements": chosen.refinements,
                "coarse_error": chosen.error.relative_rms,
                "choosing_seconds": choosing,
                "seconds": seconds,
                **errors,
            }
        )
    kept = sum(one["relative_rms"] <= TOLERANCE for one in found)
    rows = [
        (one["scene"], one["refinements"], f"{one['coarse_error']:.2%}", one["choosing_seconds"], one["seconds"], *error_cells(one))
        for one in found
    ]  # fmt: skip
    columns = ("scene", "refined", "coarse picture", "choosing [s]", "light [s]", *ERROR_COLUMNS)
    title = f"a tolerance of {TOLERANCE:.0%} at {width} x {height}: kept in {kept} of {len(found)}"
    return {"kept": kept, "scenes": found}, (make_table(title, columns, rows),)
