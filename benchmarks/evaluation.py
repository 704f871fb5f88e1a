"""What does an evaluation of the objective cost in time and memory, by which loss and for how many candidates at once?

The histograms of 20 candidates behind the paper's 11 amounts of air in 3 channels over 40 000 cloud pixels are counted by the package, by a
plain scalar loop (numba) and by torch as one writes it, one after the other in every repetition. Then whole evaluations: of every
loss, of populations of 1 to 256 with the peak memory of a process of their own, and with a search over the air that begins
with every third depth, with what that does to the loss.
"""

import argparse
import contextlib
import multiprocessing
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.table import Table
from torch import Tensor

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
    tell_progress,
)
from benchmarks.synthetic_photograph import MIDDLE, photograph_of_opacity
from cloudfit.colour_histogram import STEPS, build_level_table, haze_histograms
from cloudfit.fit_problem import FitProblem
from cloudfit.fit_types import AIR_DEPTHS
from cloudfit.losses import LOSSES
from cloudfit.soft_haze import display_values
from cloudfit.stack import prepare_stack
from render.fused import fused_loops_wanted, torch_loops_only

POPULATION = 20
"""Individuals of the paper's genetic algorithm."""

PIXELS = 40_000
"""Cloud pixels that are counted: about half of 320 x 240."""

STARTS = 8
"""Candidates whose gradient is taken at once."""

ACCEPTED = {"counting_ms": 60.0, "counting_over_scalar_loop": 1.6}
"""On two cores."""

Count = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Clouds (population, channel, pixel), sky (channel, pixel), weights (kappa,) -> histograms (population, kappa, channel, bin)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    add_volume_argument(parser)
    parser.add_argument("--repeats", type=int, default=15, help="timings of each way")
    parser.add_argument("--threads", type=int, default=available_cores())


def run(arguments: argparse.Namespace) -> Outcome:
    """Time everything on one problem."""
    set_threads(arguments.threads)
    repeats = 2 if arguments.quick else arguments.repeats
    populations = (1, 4) if arguments.quick else (1, 2, 4, 8, 16, 32, 64, 128, 256)
    with tempfile.TemporaryDirectory() as folder:
        task = Task(arguments, Path(folder), 0, repeats)
        problem, volume = pose(task)
        tell_progress("counting")
        counting = time_counting(problem, 500 if arguments.quick else PIXELS, repeats)
        tell_progress("losses")
        losses = {name: time_loss(replace(problem, loss=name), repeats) for name in LOSSES}
        tell_progress("coarse air")
        coarse = compare_air(problem, 20 if arguments.quick else 400, repeats)
        context = multiprocessing.get_context("spawn")
        scaling = {}
        for population in populations:
            tell_progress(f"population {population}")
            # A process for each, so that the peak of one is not that of another.
            with ProcessPoolExecutor(1, context) as pool:
                scaling[population] = pool.submit(measure_population, replace(task, population=population)).result()
    values = {
        "volume": volume,
        "threads": arguments.threads,
        "counted_pixels": len(problem.counted),
        "accepted": ACCEPTED,
        "counting_ms": counting,
        "losses_ms": losses,
        "coarse_air": coarse,
        "populations": {str(population): measured for population, measured in scaling.items()},
    }
    return Outcome(values, tables_of(values), notes_of(problem))


@dataclass(frozen=True)
class Task:
    """What a process is told.

    Args:
        arguments: of the command line.
        folder: for the stack and the photograph.
        population: candidates evaluated at once.
        repeats: number of timings.
    """

    arguments: argparse.Namespace
    folder: Path
    population: int
    repeats: int


def pose(task: Task) -> tuple[FitProblem, str]:
    """The problem, with tables of 320 x 240 whose noise is of no interest here, and the name of its volume."""
    width, height = (32, 24) if task.arguments.quick else (320, 240)
    scene, volume = scene_of(task.arguments, width, height)
    stack, _ = prepare_stack(scene, QUICK_QUALITY, 0, task.folder)
    photograph = photograph_of_opacity(scene, scene.camera, MIDDLE, task.folder / "cloud.png")
    return FitProblem(photograph.analysis(), stack), volume


def draw(problem: FitProblem, population: int, seed: int = 0) -> Tensor:
    """Random candidates."""
    return torch.rand(population, problem.space.dimension, generator=torch.Generator().manual_seed(seed))


def time_counting(problem: FitProblem, pixels: int, repeats: int) -> dict[str, dict[str, float]]:
    """Milliseconds of each way of counting, interleaved; all must count the same but for pixels on the border of two levels."""
    with torch.no_grad():
        cloud = problem.compose(problem.space.to_physical(draw(problem, POPULATION)))
    chosen = torch.arange(pixels) % cloud.shape[-1]
    cloud, sky = cloud[..., chosen].contiguous(), problem.sky[:, chosen].contiguous()
    weights = torch.exp(-torch.tensor(AIR_DEPTHS))
    ways = ways_of_counting()
    expected = haze_histograms(cloud, sky, weights)
    for name, count in ways.items():
        difference = float((count(cloud, sky, weights) - expected).abs().sum(-1).mean())
        if difference > 0.02:
            raise RuntimeError(f"{name} counts other levels: L1 {difference}")
    durations: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(repeats):
        for name, count in ways.items():
            with stopwatch() as seconds:
                count(cloud, sky, weights)
            durations[name].append(1000.0 * seconds[0])
    result = {name: spread(values) for name, values in durations.items()}
    if "scalar loop" in durations:
        result["ratio"] = spread(
            ours / theirs for ours, theirs in zip(durations["cloudfit"], durations["scalar loop"], strict=True)
        )
    return result


def ways_of_counting() -> Mapping[str, Count]:
    """The ways by name; those of numba where it is installed."""
    ways: dict[str, Count] = {"cloudfit": haze_histograms}
    if find_spec("numba") is not None:
        ways["scalar loop"] = count_by_numba
    if fused_loops_wanted():
        ways["cloudfit without numba"] = count_without_numba
    return ways | {"torch, scatter_add": count_by_scatter_add, "torch, bincount": count_by_bincount}


def count_without_numba(cloud: Tensor, sky: Tensor, weights: Tensor) -> Tensor:
    """The package where numba is not installed."""
    with torch_loops_only():
        return haze_histograms(cloud, sky, weights)


def count_by_numba(cloud: Tensor, sky: Tensor, weights: Tensor) -> Tensor:
    """The scalar loop."""
    from benchmarks.scalar_histogram import count_by_scalar_loop  # needs numba

    table = build_level_table("srgb")
    counts = count_by_scalar_loop(cloud.numpy(), sky.numpy(), weights.numpy(), table.levels, STEPS)
    return torch.from_numpy(counts.astype(np.float64)) / cloud.shape[-1]


def _levels(cloud: Tensor, sky: Tensor, weight: Tensor) -> Tensor:
    """Display levels of one haze `(population x channel, pixel)`."""
    return (255.0 * display_values(weight * (cloud - sky) + sky, "srgb")).round().long().flatten(0, 1)


def count_by_scatter_add(cloud: Tensor, sky: Tensor, weights: Tensor) -> Tensor:
    """Eager torch: one haze at a time, `scatter_add_`."""
    rows, ones = len(cloud) * len(sky), torch.ones((1, 1)).expand(len(cloud) * len(sky), cloud.shape[-1])
    counts = [torch.zeros(rows, 256).scatter_add_(1, _levels(cloud, sky, weight), ones) for weight in weights]
    return torch.stack(counts).unflatten(1, (len(cloud), len(sky))).transpose(0, 1).double() / cloud.shape[-1]


def count_by_bincount(cloud: Tensor, sky: Tensor, weights: Tensor) -> Tensor:
    """Eager torch: one haze at a time, `bincount` over all candidates and channels."""
    rows = len(cloud) * len(sky)
    offset = 256 * torch.arange(rows)[:, None]
    counts = [
        torch.bincount((_levels(cloud, sky, weight) + offset).flatten(), minlength=256 * rows) for weight in weights
    ]
    return (
        torch.stack(counts).reshape(len(weights), len(cloud), len(sky), 256).transpose(0, 1).double() / cloud.shape[-1]
    )


def time_loss(problem: FitProblem, repeats: int) -> dict[str, dict[str, float]]:
    """Milliseconds of evaluations of `POPULATION` candidates, and of `STARTS` with gradients where there are any."""
    population = draw(problem, POPULATION)
    result = {"evaluation": time_repeatedly(lambda: problem(population), repeats)}
    if LOSSES[problem.loss].is_differentiable:
        starts = population[:STARTS]
        result["starts"] = time_repeatedly(lambda: problem(starts), repeats)
        result["starts_with_gradient"] = time_repeatedly(lambda: problem.with_gradient(starts), repeats)
    return result


def time_repeatedly(work: Callable[[], object], repeats: int) -> dict[str, float]:
    """Milliseconds; the first call fills caches and is left out."""
    durations = []
    for _ in range(repeats + 1):
        with stopwatch() as seconds:
            work()
        durations.append(1000.0 * seconds[0])
    return spread(durations[1:])


def compare_air(problem: FitProblem, candidates: int, repeats: int) -> dict[str, object]:
    """Time of both searches over the air, and how much higher the loss of the coarse one is, in floors of the loss."""
    result: dict[str, object] = {"floor": problem.floor, "candidates": candidates}
    timed, population = draw(problem, POPULATION), draw(problem, candidates, seed=1)
    for refinements in (0, problem.air_refinements):
        full = replace(problem, air_refinements=refinements)
        coarse = replace(full, coarse_air=True)
        excess = (coarse(population) - full(population)) / problem.floor
        result[f"refined {refinements} times"] = {
            "full_ms": time_repeatedly(lambda full=full: full(timed), repeats),  # type: ignore[misc]
            "coarse_ms": time_repeatedly(lambda coarse=coarse: coarse(timed), repeats),  # type: ignore[misc]
            "excess_mean": float(excess.mean()),
            "excess_99th_percentile": float(excess.quantile(0.99)),
            "excess_largest": float(excess.max()),
            "share_with_excess": float((excess > 1e-9).double().mean()),
        }
    return result


def measure_population(task: Task) -> dict[str, object]:
    """Time and peak memory of evaluations of one population; runs in a process of its own."""
    set_threads(task.arguments.threads)
    problem, _ = pose(task)
    problem(draw(problem, 1))  # tables and targets that every population needs
    population = draw(problem, task.population)
    forget_peak()
    held = peak_memory_mb()
    timing = time_repeatedly(lambda: problem(population), min(task.repeats, 5))
    evaluated = peak_memory_mb()
    forget_peak()
    replace(problem, loss="sorted_wasserstein").with_gradient(population)
    return {
        "ms": timing,
        "ms_per_candidate": timing["median"] / task.population,
        "held_mb": held,
        "peak_mb": evaluated,
        "peak_with_gradient_mb": peak_memory_mb(),
    }


def forget_peak() -> None:
    """Let the peak memory of this process start again from what it holds now, where the system can do that (Linux)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def tables_of(values: Mapping[str, object]) -> tuple[Table, ...]:
    """The measurements to read."""
    counting, losses, coarse, populations = (
        values[name] for name in ("counting_ms", "losses_ms", "coarse_air", "populations")
    )
    assert isinstance(counting, dict)
    assert isinstance(losses, dict)
    assert isinstance(coarse, dict)
    assert isinstance(populations, dict)
    return (
        _counting_table(counting),
        _losses_table(losses, values["counted_pixels"]),
        _coarse_table(coarse),
        _populations_table(populations),
    )


def _counting_table(counting: dict[str, dict[str, float]]) -> Table:
    accepted = {"cloudfit": ACCEPTED["counting_ms"], "ratio": ACCEPTED["counting_over_scalar_loop"]}
    names = {"cloudfit": "cloudfit [ms]", "ratio": "cloudfit over scalar loop"}
    return make_table(
        f"histograms of {POPULATION} candidates x {len(AIR_DEPTHS)} hazes x 3 channels",
        ("way", "median [quartiles]", "accepted"),
        [
            (names.get(name, f"{name} [ms]"), show(summary), f"{accepted[name]:g}" if name in accepted else "")
            for name, summary in counting.items()
        ],
    )


def _losses_table(losses: dict[str, dict[str, dict[str, float]]], pixels: object) -> Table:
    return make_table(
        f"whole evaluation, {pixels} pixels [ms]",
        ("loss", f"{POPULATION} candidates", f"{STARTS} candidates", f"{STARTS} with gradients"),
        [
            (
                name,
                *(show(ways[way]) if way in ways else "" for way in ("evaluation", "starts", "starts_with_gradient")),
            )
            for name, ways in losses.items()
        ],
    )


def _coarse_table(coarse: dict[str, Any]) -> Table:
    return make_table(
        f"search over the air from every third depth; excess loss in floors of {coarse['floor']:.3f}",
        ("search", "full [ms]", "coarse [ms]", "mean excess", "99th percentile", "largest", "candidates with any"),
        [
            (
                name,
                show(row["full_ms"]),
                show(row["coarse_ms"]),
                row["excess_mean"],
                row["excess_99th_percentile"],
                row["excess_largest"],
                f"{row['share_with_excess']:.1%}",
            )
            for name, row in coarse.items()
            if isinstance(row, dict)
        ],
    )


def _populations_table(populations: dict[str, Any]) -> Table:
    return make_table(
        "populations",
        (
            "candidates",
            "evaluation [ms]",
            "per candidate [ms]",
            "held before [MiB]",
            "peak [MiB]",
            "peak with gradients [MiB]",
        ),
        [
            (
                name,
                show(row["ms"]),
                *(row[key] for key in ("ms_per_candidate", "held_mb", "peak_mb", "peak_with_gradient_mb")),
            )
            for name, row in populations.items()
        ],
    )


def notes_of(problem: FitProblem) -> tuple[str, ...]:
    """What was measured how."""
    return (
        "every way of counting runs once in each repetition, one after the other; the ratio is taken within repetitions",
        f"pixels are those of random candidates of the problem ({len(problem.counted)} counted ones, repeated up to the number timed)",
        "the scalar loop and cloudfit take levels from the same table; eager torch computes the sRGB curve of every pixel",
        "memory is the resident memory of the whole process, with all that it imports: before, and at the peak during the evaluations",
        "the excess is that of random candidates; the tables are rough, which changes neither times nor memory",
    )
