"""What do a scattering stack and one iteration of the search cost in time, memory and disk, at which error?

The stack of a fit at standard quality: tables of 320 x 240 pixels for pictures of 640 x 480, 11 asymmetries x 11
extinctions, orders 2 to 4. Each repetition builds it in a process of its own with another seed. The paper of 2012 took 12 to 28 minutes for
its precomputation and 100 ms an iteration, on a GTX 590.
"""

import argparse
import multiprocessing
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from benchmarks.common import (
    QUICK_QUALITY,
    Outcome,
    add_volume_argument,
    available_cores,
    make_table,
    peak_memory_mb,
    scene_of,
    set_threads,
    show,
    spread,
    stopwatch,
)
from benchmarks.synthetic_photograph import MIDDLE, photograph_of_opacity
from cloudfit.fit_problem import FitProblem
from cloudfit.fit_types import AIR_DEPTHS, AIR_REFINEMENTS
from cloudfit.quality import QUALITIES
from cloudfit.stack import prepare_stack

POPULATION = 20
"""Individuals of the genetic algorithm."""

ACCEPTED = {"build_seconds": 90.0, "iteration_ms": 100.0, "peak_memory_mb": 2048.0, "file_mb": 150.0}


@dataclass(frozen=True)
class Task:
    """One repetition, as its process is told.

    Args:
        arguments: of the command line.
        seed: of the stack and the population.
        threads: of the process.
        iterations: number of timed evaluations.
    """

    arguments: argparse.Namespace
    seed: int
    threads: int
    iterations: int


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    add_volume_argument(parser)
    parser.add_argument("--quality", choices=QUALITIES, default="standard")
    parser.add_argument("--repeats", type=int, default=3, help="stacks to build")
    parser.add_argument("--threads", type=int, default=available_cores())


def run(arguments: argparse.Namespace) -> Outcome:
    """Build and time."""
    repeats, iterations = (1, 3) if arguments.quick else (arguments.repeats, 15)
    context = multiprocessing.get_context("spawn")
    measured = []
    for seed in range(repeats):
        # A process for each, so that the peak of one is not that of another.
        with ProcessPoolExecutor(1, context) as pool:
            measured.append(pool.submit(measure, Task(arguments, seed, arguments.threads, iterations)).result())
    set_threads(arguments.threads)
    first = measured[0]
    summaries = {name: spread(value for one in measured for value in one.values[name]) for name in first.values}
    rows = [(name, show(summary), _limit(name)) for name, summary in summaries.items()]
    about = {"volume": first.volume, "table": first.table, "threads": arguments.threads, "quality": arguments.quality}
    title = f"{first.volume}: {first.table}, {repeats} stacks, {arguments.threads} threads"
    notes = (
        "errors are relative RMS errors over the cloud pixels of a node's image at albedo one, from two independent halves of the paths",
        "the peak includes the memory after the imports; the iteration is one evaluation of "
        f"{POPULATION} candidates with the paper's {len(AIR_DEPTHS)} optical depths of the air in 3 channels; the refined one cuts "
        f"their step to a third {AIR_REFINEMENTS} times, with two more depths each, and is what a fit does unless told otherwise",
    )
    table = make_table(title, ("measure", "median [quartiles]", "accepted"), rows)
    return Outcome({**about, "accepted": ACCEPTED, "measures": summaries}, (table,), notes)


def _limit(name: str) -> str:
    return f"{ACCEPTED[name]:g}" if name in ACCEPTED else ""


@dataclass(frozen=True)
class Measured:
    """Measurements of one repetition.

    Args:
        volume, table: what was built, in words.
        values: by name, one or more of each.
    """

    volume: str
    table: str
    values: dict[str, list[float]]


def measure(task: Task) -> Measured:
    """Build one stack, load it, and evaluate populations on it; runs in a process of its own."""
    set_threads(task.threads)
    quick = task.arguments.quick
    width, height = (32, 24) if quick else (640, 480)
    scene, volume = scene_of(task.arguments, width, height)
    quality = QUICK_QUALITY if quick else QUALITIES[task.arguments.quality]
    imported = peak_memory_mb()
    with tempfile.TemporaryDirectory() as folder:
        stack, report = prepare_stack(scene, quality, task.seed, Path(folder))
        built = peak_memory_mb()
        with stopwatch() as loading:
            prepare_stack(scene, quality, task.seed, Path(folder))
        if report.path is None:
            raise RuntimeError("the stack was not written")
        file_mb = report.path.stat().st_size / (1 << 20)
        analysis = photograph_of_opacity(scene, scene.camera, MIDDLE, Path(folder) / "cloud.png").analysis()
    problem = FitProblem(analysis, stack, air_refinements=0)
    errors = stack.tables.image_error.flatten()
    values = {
        "build_seconds": [report.seconds],
        "load_seconds": loading,
        "iteration_ms": time_iterations(problem, task),
        "refined_iteration_ms": time_iterations(replace(problem, air_refinements=AIR_REFINEMENTS), task),
        "peak_memory_mb": [peak_memory_mb()],
        "peak_memory_of_build_mb": [built],
        "memory_after_imports_mb": [imported],
        "file_mb": [file_mb],
        "image_error_median": [float(errors.median())],
        "image_error_worst": [float(errors.max())],
        "usable_nodes": [float(stack.usable.float().mean())],
        "cloud_pixels": [float(len(problem.counted))],
    }
    tables = stack.tables
    shape = f"{tables.width} x {tables.height} pixels, {len(tables.asymmetry)} x {len(tables.extinction)} nodes, orders 2-{stack.orders}"
    return Measured(volume, shape, values)


def time_iterations(problem: FitProblem, task: Task) -> list[float]:
    """Durations of evaluations of random populations [ms]."""
    generator = torch.Generator().manual_seed(task.seed)
    durations = []
    for _ in range(task.iterations + 1):
        population = torch.rand(POPULATION, problem.space.dimension, generator=generator)
        with stopwatch() as seconds:
            problem.evaluate(population)
        durations.append(1000.0 * seconds[0])
    return durations[1:]  # the first one fills caches
