"""Methods of marching side by side: at their usual settings, at three resolutions, in one time, and with the filter's settings."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from rich.table import Table

from benchmarks.common import make_table, show, spread, tell_progress
from benchmarks.front import Point, draw_front
from benchmarks.shaft_measures import (
    ERROR_COLUMNS,
    MAPS,
    QUICK_MAPS,
    Reference,
    clocked,
    compare,
    compute_reference,
    error_cells,
    judge,
)
from render.shafts.methods import METHODS, Adaptive, Ali2017, Biri2006, BruteForce, Chen2011, Froxels, Method
from render.shafts.scene_file import load_scene
from render.shafts.stage import Stage, prepare_stage

TIMED = tuple(name for name in METHODS if name != "auto")

RESOLUTIONS = ((1280, 720), (1920, 1080), (3840, 2160))

FAST = ("adaptive", "interleaved", "chen2011")
"""Methods whose frames are counted at each resolution."""

TAPS = (2, 4, 8, 16, 32)

AIMS = 4
"""Attempts at the number of steps that fills a time."""

Outcome = tuple[Any, tuple[Table, ...]]


def prepare(name: str, arguments: argparse.Namespace, width: int | None = None, height: int | None = None) -> Stage:
    """A preset made ready at the size that is asked for."""
    size = width or arguments.width, height or arguments.height
    return prepare_stage(load_scene(name).resized(*size), QUICK_MAPS if arguments.quick else MAPS)


def prepare_judged(name: str, arguments: argparse.Namespace) -> tuple[Stage, Reference]:
    """The same with its truth."""
    stage = prepare(name, arguments)
    reference = compute_reference(stage, arguments.truth_change, arguments.whole_truth)
    tell_progress(f"{name}: truth of {len(reference.pixels):,} pixels, {reference.steps} steps")
    return stage, reference


def differs(name: str, stage: Stage) -> bool:
    """Whether a method is one of its own for a scene: without a sun, `chen2011` is `engelhardt2010`."""
    return name != "chen2011" or stage.lighting.sun is not None


def list_methods(stage: Stage, names: Sequence[str], refined: bool) -> dict[str, Method]:
    """Methods with their usual settings and, if asked for, refined."""
    methods: dict[str, Method] = {}
    for name in names:
        if not differs(name, stage):
            continue
        methods[name] = METHODS[name]
        if refined and name != "brute_force":
            methods[f"{name}, refined"] = METHODS[name].refined()
    return methods


def measure_methods(arguments: argparse.Namespace) -> Outcome:
    """Times and errors of all methods on every scene."""
    found, tables = {}, []
    for name in arguments.scenes:
        stage, reference = prepare_judged(name, arguments)
        methods = compare(
            list_methods(stage, arguments.methods, not arguments.usual_only),
            stage,
            reference,
            arguments.repeats,
            "brute_force",
        )
        found[name] = {"truth_steps": reference.steps, "truth_pixels": len(reference.pixels), "methods": methods}
        tables.append(method_table(f"{name}, truth of {len(reference.pixels):,} pixels", methods))
        if arguments.out is not None:
            points = [
                Point(key.partition(",")[0], key, one["seconds"]["median"], one["relative_rms"])
                for key, one in methods.items()
                if one["relative_rms"] > 0.0
            ]
            title = f"{name}, {arguments.width} x {arguments.height}, {arguments.threads} threads"
            error = "relative RMS error of the in-scattered light"
            draw_front(points, title, error, arguments.out, f"shafts_{name}", "seconds for the in-scattered light")
    return found, tuple(tables)


def method_table(title: str, methods: Mapping[str, Any]) -> Table:
    """Times and errors of methods on one scene."""
    rows = [(key, show(one["seconds"]), one.get("speed_up", 1.0), *error_cells(one)) for key, one in methods.items()]
    return make_table(title, ("method", "seconds", "times as fast", *ERROR_COLUMNS), rows)


def measure_stages(arguments: argparse.Namespace) -> Outcome:
    """Seconds of each part of a frame by adaptive marching."""
    found: dict[str, dict[str, Any]] = {}
    for name in arguments.scenes:
        parts: dict[str, list[float]] = {}
        for _ in range(arguments.repeats):
            stage = prepare(name, arguments)
            for part, seconds in {**stage.seconds, **METHODS["adaptive"].gather(stage).seconds}.items():
                parts.setdefault(part, []).append(seconds)
        found[name] = {part: spread(seconds) for part, seconds in parts.items()}
    names = list(dict.fromkeys(part for parts in found.values() for part in parts))
    rows = [(part, *(show(found[s][part]) if part in found[s] else "-" for s in found)) for part in names]
    return found, (make_table("seconds of the parts of a frame, adaptive", ("part", *found), rows),)


def measure_resolutions(arguments: argparse.Namespace) -> Outcome:
    """Frames per second and errors at three resolutions."""
    sizes = ((32, 18), (48, 27)) if arguments.quick else RESOLUTIONS
    found: dict[str, list[dict[str, Any]]] = {}
    rows: list[tuple[object, ...]] = []
    for name in arguments.scenes:
        found[name] = []
        for width, height in sizes:
            stage = prepare(name, arguments, width, height)
            reference = compute_reference(stage, arguments.truth_change, arguments.whole_truth)
            ready = sum(stage.seconds.values()) - stage.seconds["geometry"]
            methods: dict[str, Method] = {key: METHODS[key] for key in FAST if differs(key, stage)}
            measured = compare(methods, stage, reference, arguments.repeats)
            found[name].append({"width": width, "height": height, "ready_seconds": ready, "methods": measured})
            for key, one in measured.items():
                rate = 1.0 / (ready + one["seconds"]["median"])
                rows.append((f"{name} {width} x {height}", key, show(one["seconds"]), rate, *error_cells(one)))
    columns = ("scene", "method", "light [s]", "frames per second", *ERROR_COLUMNS)
    return found, (make_table("resolutions, frames with maps and depth", columns, rows),)


def measure_equal_time(arguments: argparse.Namespace) -> Outcome:
    """Steps that methods afford in the time of adaptive marching with its usual settings."""
    found: dict[str, dict[str, Any]] = {}
    rows: list[tuple[object, ...]] = []
    for name in arguments.scenes:
        stage, reference = prepare_judged(name, arguments)
        budget = min(clocked(METHODS["adaptive"], stage)[0] for _ in range(arguments.repeats + 1))
        found[name] = {"budget_seconds": budget, "methods": {}}
        for key in TIMED:
            if not differs(key, stage):
                continue
            one = fill_time(METHODS[key], stage, reference, budget)
            found[name]["methods"][key] = one
            rows.append((f"{name}, {budget:.3g} s", key, one["steps"], f"{one['seconds']:.3g}", *error_cells(one)))
    columns = ("scene", "method", "steps", "seconds", *ERROR_COLUMNS)
    return found, (make_table("steps of each ray in one time", columns, rows),)


def name_of_steps(method: Method) -> str:
    """The setting that counts along a ray: nodes, looks or cells where there are no steps."""
    return {Chen2011: "nodes", Biri2006: "looks", Froxels: "cells"}.get(type(method), "steps")


def with_steps(method: Any, steps: int) -> Method:
    """The same method with other steps along a ray, those at lamps included."""
    at_lamps = {"lamp_steps": max(2, steps)} if isinstance(method, Adaptive) else {}
    found: Method = replace(method, **{name_of_steps(method): steps}, **at_lamps)
    return found


def fill_time(method: Method, stage: Stage, reference: Reference, budget: float) -> dict[str, Any]:
    """The most steps that come closest to a time [s], what they took, and their errors; one step where none is short enough."""
    usual = getattr(method, name_of_steps(method))
    # The budget is the time of the adaptive method; others begin with few steps, for at their usual ones some take many minutes.
    steps = usual if isinstance(method, Adaptive) else max(1, usual // 16)
    tried: dict[int, tuple[float, dict[str, float]]] = {}
    for _ in range(AIMS):
        seconds, light = clocked(with_steps(method, steps), stage)
        tried[steps] = seconds, judge(light, reference)
        steps = max(1, min(round(steps * budget / seconds), 4096))
        if steps in tried:
            break
    within = [number for number, (seconds, _) in tried.items() if seconds <= 1.1 * budget]
    chosen = max(within) if within else min(tried)
    seconds, errors = tried[chosen]
    return {"steps": chosen, "seconds": seconds, **errors}


def measure_filter(arguments: argparse.Namespace) -> Outcome:
    """200 steps along every ray against 60 along few, filtered."""
    methods: dict[str, Method] = {
        "200 steps": BruteForce(200),
        "60 steps": BruteForce(60),
        "60 steps, filter (ali2017)": METHODS["ali2017"],
        "60 shifted steps, filter (interleaved)": METHODS["interleaved"],
    }
    return _on_scenes("filter", methods, "200 steps", arguments)


def measure_taps(arguments: argparse.Namespace) -> Outcome:
    """Taps of the filter."""
    methods: dict[str, Method] = {
        f"{'interleaved' if pattern > 1 else 'ali2017'}, {taps} taps": Ali2017(taps=taps, pattern=pattern)
        for pattern in (1, 4)
        for taps in TAPS
    }
    return _on_scenes("taps", methods, "ali2017, 4 taps", arguments)


def _on_scenes(title: str, methods: Mapping[str, Method], base: str, arguments: argparse.Namespace) -> Outcome:
    found = {}
    for name in arguments.scenes:
        stage, reference = prepare_judged(name, arguments)
        found[name] = compare(methods, stage, reference, arguments.repeats, base)
    return found, tuple(method_table(f"{title}: {name}", one) for name, one in found.items())
