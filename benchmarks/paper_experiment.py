"""How do the paper's genetic algorithm and steepest descent differ over a hundred runs on one photograph?

Dobashi et al. 2012 report, on a photograph and a volume of their own, a mean L1 loss of 0.40 with a standard deviation of 0.01 for the
genetic algorithm and 1.32 with 0.55 for steepest descent. Here both run until they end of themselves, with the paper's objective: the
L1 difference of histograms and the air in 11 steps.
"""

import argparse
import statistics
import tempfile
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.common import (
    QUICK_QUALITY,
    SHARED,
    Outcome,
    add_output_argument,
    add_volume_argument,
    make_table,
    set_threads,
    tell_progress,
)
from benchmarks.optimiser_problems import benchmark_scenes, photograph_sources, traced_sources
from benchmarks.optimisers import Teller, stop_if_interrupted
from cloudfit.batch import available_cores
from cloudfit.comparison.compare import Comparison, Settings, compare
from cloudfit.comparison.problems import ProblemSource
from cloudfit.comparison.run_record import RunRecord
from cloudfit.fit_types import FitOptions
from cloudfit.optimisers import OPTIMISERS
from cloudfit.quality import QUALITIES
from render.errors import ParameterError

RUNS, MOST_EVALUATIONS = 100, 20_000

GENETIC, DESCENT = "genetic_paper", "steepest_descent"

PAPER = {GENETIC: (0.40, 0.01), DESCENT: (1.32, 0.55)}
"""Mean and standard deviation of L1 in the paper, on its own data."""


@dataclass(frozen=True)
class Spread:
    """Final losses of a method.

    Args:
        method: name.
        runs: how many ended without failure.
        mean, deviation: of their L1 losses; the deviation is that of a sample.
        smallest, largest: of them.
        evaluations, seconds: means over the runs.
        paper: mean and standard deviation that the paper reports for the method, or None.
    """

    method: str
    runs: int
    mean: float
    deviation: float
    smallest: float
    largest: float
    evaluations: float
    seconds: float
    paper: tuple[float, float] | None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    add_volume_argument(parser)
    parser.add_argument("--photograph", type=Path, default=SHARED / "photos" / "cumulus_kloofendal_a.jpg")
    parser.add_argument("--methods", nargs="+", default=[GENETIC, DESCENT], help="names")
    parser.add_argument("--runs", type=int, default=RUNS, help="of each method")
    parser.add_argument("--evaluations", type=int, default=MOST_EVALUATIONS, help="that no run exceeds")
    parser.add_argument("--air-refinements", type=int, default=0, help="0 is the paper's search over the air")
    parser.add_argument("--quality", choices=QUALITIES, default="standard")
    parser.add_argument("--width", type=int, default=640, help="of the pictures; 4:3; the tables have half of it")
    parser.add_argument("--jobs", type=int, default=1, help="runs at the same time")
    parser.add_argument("--threads", type=int, default=available_cores(), help="of a run, where there is one job")
    add_output_argument(parser, "folder of runs, tables and a page with the best and worst pictures")


def run(arguments: argparse.Namespace) -> Outcome:
    """Do the runs; quick ones on a made-up photograph."""
    if arguments.quick:
        arguments.runs, arguments.width, arguments.evaluations = 3, 48, 80
    missing = [name for name in arguments.methods if name not in OPTIMISERS]
    if missing:
        raise ParameterError(f"there is no optimiser {', '.join(missing)}; there are {', '.join(OPTIMISERS)}")
    set_threads(max(1, arguments.threads // arguments.jobs))
    with tempfile.TemporaryDirectory() if arguments.out is None else nullcontext(arguments.out) as folder:
        out = Path(folder)
        out.mkdir(parents=True, exist_ok=True)
        settings = Settings(out, arguments.evaluations, seeds=arguments.runs, restarts=False, jobs=arguments.jobs)
        methods = {name: OPTIMISERS[name] for name in arguments.methods}
        comparison = compare(_sources(arguments, out), methods, settings, Teller())
    stop_if_interrupted(comparison)
    return _report(arguments, comparison)


def _sources(arguments: argparse.Namespace, out: Path) -> list[ProblemSource]:
    quality = QUICK_QUALITY if arguments.quick else QUALITIES[arguments.quality]
    options = FitOptions(quality=quality, air_refinements=arguments.air_refinements)
    scene = benchmark_scenes(arguments, out, arguments.width, arguments.width * 3 // 4)[0]
    if arguments.quick:
        return traced_sources(1, scene, options, out / "tables", out / "photographs", quick=True)
    return photograph_sources([arguments.photograph], [scene], options, out / "tables")


def spread_of(method: str, runs: Sequence[RunRecord]) -> Spread:
    """Mean and standard deviation of the final losses of a method's runs that did not fail.

    Raises:
        ParameterError: when fewer than two are left.
    """
    done = [run for run in runs if run.method == method and not run.failed]
    losses = [run.loss for run in done]
    if len(losses) < 2:
        raise ParameterError(f"{method}: a standard deviation takes two runs, {len(losses)} ended without failure")
    return Spread(
        method,
        len(done),
        statistics.fmean(losses),
        statistics.stdev(losses),
        min(losses),
        max(losses),
        statistics.fmean(run.evaluations for run in done),
        statistics.fmean(run.seconds for run in done),
        PAPER.get(method),
    )


def _report(arguments: argparse.Namespace, comparison: Comparison) -> Outcome:
    spreads = [spread_of(name, comparison.report.runs) for name in arguments.methods]
    columns = ("method", "runs", "mean L1", "deviation", "smallest", "largest", "evaluations", "seconds", "paper")
    rows = []
    for one in spreads:
        paper = "" if one.paper is None else f"{one.paper[0]:.2f} / {one.paper[1]:.2f}"
        losses = [f"{value:.3f}" for value in (one.mean, one.deviation, one.smallest, one.largest)]
        rows.append((one.method, str(one.runs), *losses, one.evaluations, one.seconds, paper))
    names = ("runs", "evaluations", "air_refinements", "quality", "width", "jobs", "threads")
    (problem,) = comparison.document["problems"]
    values = {
        "settings": {name: getattr(arguments, name) for name in names},
        "problem": problem,
        "spreads": [asdict(one) for one in spreads],
    }
    notes = [
        "each run until its method ends of itself; the paper's figures are of another photograph and another volume",
        f"floor of the loss: {problem['floor']:.3f}; best loss found: {problem['best_loss']:.3f}",
    ]
    if arguments.out is not None:
        tell_progress(f"best and worst pictures: {comparison.page}")
    return Outcome(values, (make_table(problem["name"], columns, rows),), tuple(notes))
