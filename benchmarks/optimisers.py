"""Which optimiser finds the best parameters, in how many evaluations and seconds, beside pycma and scipy?

Real photographs in two scenes and path-traced ones with known parameters; every method from many seeds with the same budget. A method
that ends of itself is started again. What is finished stays in `--out`, and a second call does only what is missing.
"""

import argparse
import tempfile
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from rich.table import Table

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
from benchmarks.optimiser_problems import benchmark_scenes, photograph_sources, real_photographs, traced_sources
from cloudfit.batch import available_cores
from cloudfit.comparison.compare import EVALUATIONS, SEEDS, Comparison, Settings, compare
from cloudfit.comparison.experiment import SilentListener
from cloudfit.comparison.problems import ProblemSource
from cloudfit.comparison.run_record import RunRecord
from cloudfit.fit_types import FitOptions
from cloudfit.optimisers import DEFAULT_OPTIMISER, OPTIMISERS
from cloudfit.optimisers.base import Minimiser
from cloudfit.quality import QUALITIES
from render.errors import ParameterError

QUICK_METHODS = ("genetic", "crs2_lm", "scipy_de_generations")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    add_volume_argument(parser)
    parser.add_argument("--photographs", type=Path, default=SHARED / "photos", help="folder")
    parser.add_argument("--real", type=int, default=5, help="photographs taken from it, each in each scene")
    parser.add_argument("--traced", type=int, default=4, help="path-traced photographs with known parameters")
    parser.add_argument("--methods", nargs="+", help="names; without it all of ours and the peers")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--evaluations", type=int, default=EVALUATIONS, help="budget of a run")
    parser.add_argument("--seconds", type=float, help="limit of a run beside that")
    parser.add_argument("--quality", choices=QUALITIES, default="standard")
    parser.add_argument("--width", type=int, default=640, help="of the pictures; 4:3; the tables have half of it")
    parser.add_argument(
        "--jobs",
        type=int,
        default=1,
        help="runs at the same time; with a thread each, seconds are those of the processor",
    )
    parser.add_argument("--threads", type=int, default=available_cores(), help="of a run, where there is one job")
    add_output_argument(parser, "folder of runs, tables, photographs and page")


def run(arguments: argparse.Namespace) -> Outcome:
    """Compare; quick runs take two made-up photographs."""
    if arguments.quick:
        arguments.real, arguments.traced, arguments.seeds, arguments.evaluations = 0, 2, 2, 60
        arguments.width, arguments.methods = 48, arguments.methods or list(QUICK_METHODS)
    set_threads(max(1, arguments.threads // arguments.jobs))
    methods = choose(arguments.methods)
    with tempfile.TemporaryDirectory() if arguments.out is None else nullcontext(arguments.out) as folder:
        out = Path(folder)
        out.mkdir(parents=True, exist_ok=True)
        sources = list_sources(arguments, out)
        settings = Settings(out, arguments.evaluations, arguments.seconds, arguments.seeds, jobs=arguments.jobs)
        comparison = compare(sources, methods, settings, Teller())
    stop_if_interrupted(comparison)
    return _report(arguments, comparison)


def choose(names: list[str] | None) -> dict[str, Minimiser]:
    """Our methods and the peers, or those of them that are named.

    Raises:
        ParameterError: there is none of a name, or the peers are not installed.
    """
    try:
        from benchmarks.optimiser_peers import PEERS
    except ImportError as error:
        raise ParameterError(
            f"the peers need the extra bench, with {error.name}: pip install 'cloudfit[bench]'"
        ) from error
    every = {**OPTIMISERS, **PEERS}
    for name in names or ():
        if name not in every:
            raise ParameterError(f"no optimiser is called {name!r}; there are {', '.join(every)}")
    return {name: every[name] for name in names or every}


def list_sources(arguments: argparse.Namespace, out: Path) -> list[ProblemSource]:
    """Real photographs in every scene, and path-traced ones in the first."""
    options = FitOptions(quality=QUICK_QUALITY if arguments.quick else QUALITIES[arguments.quality])
    scenes = benchmark_scenes(arguments, out, arguments.width, arguments.width * 3 // 4)
    tables = out / "tables"
    photographs = real_photographs(arguments.photographs, arguments.real) if arguments.real else []
    sources = photograph_sources(photographs, scenes, options, tables)
    return sources + traced_sources(arguments.traced, scenes[0], options, tables, out / "photographs", arguments.quick)


class Teller(SilentListener):
    """Says on stderr how far a comparison is."""

    def __init__(self) -> None:
        self._total = self._done = 0

    def planned(self, total: int, kept: int) -> None:
        """Say what is to be done."""
        self._total, self._done = total, kept
        tell_progress(f"{total} runs, {kept} of them done before")

    def finished(self, record: RunRecord) -> None:
        """A line for each run."""
        self._done += 1
        end = f"failed: {record.message}" if record.failed else f"loss {record.loss:.4f}, {record.seconds:.1f} s"
        tell_progress(f"{self._done} of {self._total}: {record.problem}, {record.method}, seed {record.seed}: {end}")


def stop_if_interrupted(comparison: Comparison) -> None:
    """Pass Ctrl-C on, once what is finished is safe."""
    if comparison.report.interrupted:
        tell_progress("interrupted; the same command goes on where this one stopped, if --out is given")
        raise KeyboardInterrupt


def _report(arguments: argparse.Namespace, comparison: Comparison) -> Outcome:
    document = comparison.document
    names = ("seeds", "evaluations", "seconds", "quality", "width", "jobs", "threads", "real", "traced")
    values = {"arguments": {name: getattr(arguments, name) for name in names}, **document}
    notes = [
        "area: anytime area over the logarithm of evaluations, or of seconds; excess: over the best loss that anyone found",
        f"the default of cloudfit fit is {DEFAULT_OPTIMISER}",
        *(
            f"{name} is left out: {reason}"
            for name, reason in {**comparison.refused, **comparison.report.refused}.items()
        ),
        *(
            f"{run.method} failed on {run.problem}, seed {run.seed}: {run.message}"
            for run in comparison.report.failed[:20]
        ),
    ]
    if arguments.out is not None:
        tell_progress(f"page: {comparison.page}")
    return Outcome(values, (method_table(document), problem_table(document)), tuple(notes))


def method_table(document: Mapping[str, Any]) -> Table:
    """Methods in the order of their anytime area."""
    columns = ("method", "area", "area, seconds", "success", "excess [quartiles]", "evaluations", "seconds", "overhead")
    methods = {row["method"]: row for row in document["methods"]}
    rows = []
    for name in document["ranking_by_evaluations"]:
        row = methods[name]
        spread = [
            "never" if row["excess"][key] is None else f"{row['excess'][key]:.1%}"
            for key in ("median", "lower_quartile", "upper_quartile")
        ]
        rows.append(
            (
                name,
                f"{row['aocc_evaluations']:.3f}",
                f"{row['aocc_seconds']:.3f}",
                f"{row['success_rate']:.0%}",
                f"{spread[0]} [{spread[1]}, {spread[2]}]",
                row["evaluations"],
                row["seconds"],
                row["overhead_seconds"],
            )
        )
    return make_table(f"Methods on {len(document['problems'])} problems", columns, rows)


def problem_table(document: Mapping[str, Any]) -> Table:
    """Best loss of each problem."""
    rows = []
    for row in document["problems"]:
        truth = "" if row["truth_loss"] is None else f"{row['truth_loss']:.4f}"
        rows.append((row["name"], f"{row['best_loss']:.4f}", row["best_method"], f"{row['floor']:.4f}", truth))
    return make_table("Problems", ("problem", "best loss", "found by", "floor", "truth"), rows)
