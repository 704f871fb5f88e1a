"""What does each way of marching shafts of light cost in time, at which error?

Three scenes that `cloudfit shafts` shows (a ridge, a window, lamps at night), each made ready once: depth buffer and shadow maps are the
same for all methods and are not timed. A method's seconds are those of its in-scattered light, its error that against the truth: a
march along every pixel's ray whose steps are doubled until they change the light by less than 0.1 %, with the same maps. Methods take
turns. Each runs with its usual settings and refined, so that times can be compared at equal error. Brute force has the 200 steps of Ali
et al. 2017. A second table grows the number of triangles, a third that of the lamps.
"""

import argparse
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from rich.table import Table

from benchmarks.common import (
    Outcome,
    available_cores,
    make_table,
    set_threads,
    show,
    spread,
    tell_progress,
)
from render.camera import PinholeCamera
from render.shafts.casters import make_ground, make_sphere
from render.shafts.lights import PointLight
from render.shafts.methods import METHODS, Method
from render.shafts.ray_casting import RayCaster
from render.shafts.scene import ShaftScene
from render.shafts.scene_file import load_scene
from render.shafts.stage import MapSettings, Stage, prepare_stage
from render.shafts.truth import compute_truth, measure_error

SCENES = ("ridge", "window", "lights")

TIMED = ("brute_force", "adaptive", "engelhardt2010", "chen2011", "ali2017")

SPHERE_RINGS = (16, 32, 62, 124, 246, 500)
"""Of spheres of 1 k to 1 M triangles."""

LAMP_NUMBERS = (1, 2, 4, 8, 16, 32)

MAPS, QUICK_MAPS = MapSettings(2048, 256), MapSettings(128, 32)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    parser.add_argument("--width", type=int, default=1920)
    parser.add_argument("--height", type=int, default=1080)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--repeats", type=int, default=3, help="timings of each method")
    parser.add_argument(
        "--truth-change", type=float, default=1e-3, help="relative change at which the truth has converged"
    )
    parser.add_argument("--threads", type=int, default=available_cores())


def run(arguments: argparse.Namespace) -> Outcome:
    """Measure every scene, and how the cost grows with triangles and lamps."""
    set_threads(arguments.threads)
    if arguments.quick:
        arguments.width, arguments.height, arguments.repeats, arguments.truth_change = 32, 18, 1, 0.05
    scenes = {name: measure_scene(name, arguments) for name in arguments.scenes}
    triangles = measure_triangles(arguments, SPHERE_RINGS[:2] if arguments.quick else SPHERE_RINGS)
    lamps = measure_lamps(arguments, LAMP_NUMBERS[:2] if arguments.quick else LAMP_NUMBERS)
    values = {
        "width": arguments.width,
        "height": arguments.height,
        "threads": arguments.threads,
        "scenes": scenes,
        "triangles": triangles,
        "lamps": lamps,
    }
    notes = (
        "seconds are those of the in-scattered light; the depth buffer and the shadow maps, the same for all, come on top",
        f"the truth: steps doubled until the light changes by less than {arguments.truth_change:.1%}",
    )
    return Outcome(values, (*map(scene_table, scenes.items()), triangle_table(triangles), lamp_table(lamps)), notes)


def list_methods() -> dict[str, Method]:
    """Methods with their usual settings and refined."""
    methods: dict[str, Method] = {}
    for name in TIMED:
        methods[name] = METHODS[name]
        if name != "brute_force":
            methods[f"{name}, refined"] = METHODS[name].refined()
    return methods


def measure_scene(name: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Times and errors of all methods on one scene."""
    tell_progress(name)
    scene = load_scene(name).resized(arguments.width, arguments.height)
    stage = prepare_stage(scene, QUICK_MAPS if arguments.quick else MAPS)
    truth = compute_truth(stage, arguments.truth_change)
    tell_progress(f"{name}: truth of {truth.steps} steps")
    methods = list_methods()
    seconds: dict[str, list[float]] = {key: [] for key in methods}
    errors = {}
    for _ in range(arguments.repeats):
        for key, method in methods.items():
            spent, light = clocked(method, stage)
            seconds[key].append(spent)
            errors[key] = measure_error(light, truth.in_scattering)
    brute = spread(seconds["brute_force"])["median"]
    found = {
        key: {
            "seconds": spread(seconds[key]),
            "relative_rms": errors[key].relative_rms,
            "largest": errors[key].largest,
            "speed_up": brute / spread(seconds[key])["median"],
        }
        for key in methods
    }
    return {"truth_steps": truth.steps, "truth_change": truth.change, "stage_seconds": stage.seconds, "methods": found}


def clocked(method: Method, stage: Stage) -> tuple[float, torch.Tensor]:
    """Seconds and light of one run."""
    begun = time.perf_counter()
    light = method.gather(stage).in_scattering
    return time.perf_counter() - begun, light


def scene_table(item: tuple[str, Mapping[str, Any]]) -> Table:
    """Times and errors of one scene."""
    name, values = item
    rows = [
        (key, show(found["seconds"]), found["speed_up"], f"{found['relative_rms']:.2%}", f"{found['largest']:.2%}")
        for key, found in values["methods"].items()
    ]
    title = f"{name}, truth of {values['truth_steps']} steps"
    return make_table(title, ("method", "seconds", "times brute force", "relative RMS", "largest error"), rows)


def measure_triangles(arguments: argparse.Namespace, rings: tuple[int, ...]) -> list[dict[str, Any]]:
    """Seconds of a frame, from meshes to light, for spheres of more and more triangles."""
    tell_progress("triangles")
    base = load_scene("window")
    camera = PinholeCamera((0.0, -6.0, 1.0), (0.0, 0.0, 1.0), 0.8, arguments.width // 2, arguments.height // 2)
    found = []
    for number in rings:
        ball = make_sphere((0.0, 0.0, 1.2), 1.0, number)
        scene = replace(base, camera=camera, meshes=(ball, make_ground(20.0)), reach=40.0)
        found.append({"triangles": len(ball.triangles), **measure_frames(scene, arguments)})
    return found


def measure_frames(scene: ShaftScene, arguments: argparse.Namespace) -> dict[str, Any]:
    """Seconds of making ready (without building the ray caster) and of gathering, by adaptive marching."""
    build: list[float] = []
    ready: list[float] = []
    gather: list[float] = []
    for _ in range(arguments.repeats):
        begun = time.perf_counter()
        RayCaster(scene.meshes)
        build.append(time.perf_counter() - begun)
        stage = prepare_stage(scene, QUICK_MAPS if arguments.quick else MAPS)
        ready.append(sum(stage.seconds.values()) - stage.seconds["geometry"])
        gather.append(clocked(METHODS["adaptive"], stage)[0])
    return {"build": spread(build), "ready": spread(ready), "gather": spread(gather)}


def triangle_table(found: list[dict[str, Any]]) -> Table:
    """Cost against triangles."""
    rows = [(f"{one['triangles']:,}", *(show(one[part]) for part in ("build", "ready", "gather"))) for one in found]
    return make_table("triangles", ("triangles", "building [s]", "maps and depth [s]", "light [s]"), rows)


def measure_lamps(arguments: argparse.Namespace, numbers: tuple[int, ...]) -> list[dict[str, Any]]:
    """Seconds of a frame for more and more lamps."""
    tell_progress("lamps")
    base = load_scene("lights").resized(arguments.width // 2, arguments.height // 2)
    found = []
    for number in numbers:
        lamps = tuple(_lamp(n) for n in range(number))
        found.append({"lamps": number, **measure_frames(replace(base, lights=lamps), arguments)})
    return found


def _lamp(number: int) -> PointLight:
    """Lamps in rows of eight."""
    row, column = divmod(number, 8)
    return PointLight((3.0 * (column - 3.5), 0.5 + 3.0 * row, 2.6), (20.0, 14.0, 8.0))


def lamp_table(found: list[dict[str, Any]]) -> Table:
    """Cost against lamps."""
    rows = [(str(one["lamps"]), show(one["ready"]), show(one["gather"])) for one in found]
    return make_table("lamps", ("lamps", "maps and depth [s]", "light [s]"), rows)
