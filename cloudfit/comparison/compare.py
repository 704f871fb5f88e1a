"""A whole comparison: load the problems, do the runs that are missing, analyse all of them, write the report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cloudfit.comparison.analysis import Analysis
from cloudfit.comparison.document import Circumstances
from cloudfit.comparison.experiment import SILENT, Experiment, ExperimentListener, ExperimentReport, conduct
from cloudfit.comparison.page import write_report
from cloudfit.comparison.problems import ProblemSource, load_problem
from cloudfit.optimisers.base import Budget, Minimiser
from render.errors import CloudfitError, InputError, ParameterError

SEEDS = 15
"""Runs of each method on each problem by default: fewer tell little about methods that draw random numbers."""

EVALUATIONS = 1500
"""Budget of a run by default."""


@dataclass(frozen=True)
class Settings:
    """How a comparison is run.

    Args:
        out: folder of the runs and the report, made if needed.
        evaluations, seconds: budget of each run; one of the two at least.
        seeds: number of runs of each method on each problem.
        first_seed: of them.
        restarts: whether a method that ends of itself is started again while budget is left.
        jobs: runs at the same time.
    """

    out: Path
    evaluations: int | None = EVALUATIONS
    seconds: float | None = None
    seeds: int = SEEDS
    first_seed: int = 0
    restarts: bool = True
    jobs: int = 1


@dataclass(frozen=True, eq=False)
class Comparison:
    """What came out of a comparison.

    Args:
        report: the runs.
        refused: why a problem could not be loaded, by name.
        analysis: of the runs; None after an interruption.
        page: None after an interruption.
        document: as in comparison.json; empty after an interruption.
    """

    report: ExperimentReport
    refused: Mapping[str, str]
    analysis: Analysis | None = None
    page: Path | None = None
    document: Mapping[str, Any] = field(default_factory=dict)


def compare(
    sources: Sequence[ProblemSource],
    methods: Mapping[str, Minimiser],
    settings: Settings,
    listener: ExperimentListener = SILENT,
) -> Comparison:
    """Compare methods on problems; what an earlier call with the same settings has done is kept.

    Args:
        sources: of the problems; one that cannot be loaded is left out, with the reason in the outcome.
        methods: by name.
        settings: budget, seeds, folder.
        listener: is told what happens.

    Raises:
        InputError: no problem can be loaded, or the folder cannot be made.
        ParameterError: a number is out of its domain.
    """
    if settings.seeds < 1:
        raise ParameterError(f"expected at least one seed, got {settings.seeds}")
    budget = Budget(settings.evaluations, settings.seconds)
    facts, refused = _load(sources, listener)
    usable = [source for source in sources if source.name not in refused]
    if not usable:
        raise InputError(f"there is no problem to compare on: {'; '.join(refused.values())}")
    _make_folder(settings.out)
    seeds = tuple(range(settings.first_seed, settings.first_seed + settings.seeds))
    experiment = Experiment(usable, methods, seeds, budget, settings.out, settings.restarts)
    report = conduct(experiment, settings.jobs, listener)
    if report.interrupted:
        return Comparison(report, refused)
    listener.stage("report", 0.0)
    analysis = Analysis.of_runs(report.runs, facts, list(methods), settings.evaluations, settings.seconds)
    circumstances = Circumstances(settings.evaluations, settings.seconds, settings.restarts, seeds, settings.jobs)
    by_name = {source.name: source for source in usable}
    page, document = write_report(settings.out, analysis, circumstances, lambda name: load_problem(by_name[name]))
    return Comparison(report, refused, analysis, page, document)


def _load(
    sources: Sequence[ProblemSource], listener: ExperimentListener
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Facts of the problems that can be loaded, and why the others cannot."""
    facts, refused = [], {}
    for number, source in enumerate(sources):
        listener.stage(f"preparing {source.name}", number / len(sources))
        try:
            facts.append(load_problem(source).facts())
        except CloudfitError as error:
            refused[source.name] = str(error)
    return facts, refused


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the output folder {out}: {error.strerror or error}") from error
