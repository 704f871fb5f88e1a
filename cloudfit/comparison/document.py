"""A comparison as a JSON document and as tables of comma-separated values."""

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from cloudfit import __version__
from cloudfit.comparison import performance
from cloudfit.comparison.analysis import Analysis, Merit
from cloudfit.comparison.bootstrap import CONFIDENCE, RESAMPLES
from cloudfit.comparison.run_record import RunRecord
from render.atomic_write import atomic_path

SCHEMA = "cloudfit comparison 1"

RUN_COLUMNS = (
    "problem",
    "method",
    "seed",
    "failed",
    "loss",
    "excess",
    "starts",
    "evaluations",
    "seconds",
    "objective_seconds",
    "overhead_seconds",
    "threads",
    "message",
)


@dataclass(frozen=True)
class Circumstances:
    """What the tables do not say.

    Args:
        evaluations, seconds: budget of each run, or None.
        restarts: whether a method was started again while budget was left.
        seeds: of the runs.
        jobs: runs at the same time.
    """

    evaluations: int | None
    seconds: float | None
    restarts: bool
    seeds: tuple[int, ...]
    jobs: int


def describe_comparison(analysis: Analysis, circumstances: Circumstances) -> dict[str, Any]:
    """Everything as JSON; what is infinite, such as a running time without a success, is null."""
    merits = {method: analysis.merit(method) for method in analysis.methods}
    return {
        "schema": SCHEMA,
        "version": __version__,
        "settings": asdict(circumstances),
        "definitions": definitions(),
        "problems": [
            {
                **problem.facts,
                "best_loss": problem.best,
                "best_method": problem.winner.method,
                "best_parameters": problem.winner.parameters,
                "evaluations_horizon": problem.evaluations_horizon,
                "seconds_horizon": problem.seconds_horizon,
            }
            for problem in analysis.problems.values()
        ],
        "ranking_by_evaluations": analysis.ranking(False),
        "ranking_by_seconds": analysis.ranking(True),
        "methods": [{"method": method, **_merit(merit)} for method, merit in merits.items()],
        "cells": [{"problem": name, "method": method, **_merit(merit)} for name, method, merit in analysis.cells()],
        "contrasts_aocc_evaluations": [asdict(contrast) for contrast in analysis.contrasts(False)],
        "contrasts_aocc_seconds": [asdict(contrast) for contrast in analysis.contrasts(True)],
    }


def definitions() -> dict[str, Any]:
    """The numbers that the figures of merit depend on."""
    return {
        "excess": "(loss - best loss anyone found) / max(best loss anyone found, floor)",
        "lowest_excess": performance.LOWEST_EXCESS,
        "highest_excess": performance.HIGHEST_EXCESS,
        "targets": len(performance.target_excesses()),
        "success_excess": performance.SUCCESS_EXCESS,
        "profile_tolerance": performance.PROFILE_TOLERANCE,
        "time_decades": performance.TIME_DECADES,
        "bootstrap_resamples": RESAMPLES,
        "bootstrap_confidence": CONFIDENCE,
    }


def write_tables(folder: Path, analysis: Analysis) -> None:
    """Write runs.csv, cells.csv, methods.csv and contrasts.csv."""
    runs = [
        {**_run(run), "excess": float(value)}
        for problem in analysis.problems.values()
        for method in problem.runs
        for run, value in zip(problem.runs[method], problem.excess(method), strict=True)
    ]
    write_csv(folder / "runs.csv", RUN_COLUMNS, runs)
    columns = _merit_columns()
    cells = [{"problem": name, "method": method, **_flat(merit)} for name, method, merit in analysis.cells()]
    write_csv(folder / "cells.csv", ("problem", "method", *columns), cells)
    methods = [{"method": method, **_flat(analysis.merit(method))} for method in analysis.methods]
    write_csv(folder / "methods.csv", ("method", *columns), methods)
    contrasts = [
        {"merit": name, **asdict(contrast)}
        for name, by_seconds in (("aocc_evaluations", False), ("aocc_seconds", True))
        for contrast in analysis.contrasts(by_seconds)
    ]
    names = ("merit", "first", "second", "difference", "low", "high", "wins", "p_value", "p_corrected")
    write_csv(folder / "contrasts.csv", names, contrasts)


def write_csv(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a table; empty where a value is infinite."""
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows([{name: finite(value) for name, value in row.items()} for row in rows])


def finite(value: Any) -> Any:
    """The value, or None for a number that is not finite."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _run(run: RunRecord) -> dict[str, Any]:
    names = [name for name in RUN_COLUMNS if name != "excess"]
    return {name: getattr(run, name) for name in names}


def _merit(merit: Merit) -> dict[str, Any]:
    """As JSON, quartiles under their names."""
    values = asdict(merit)
    for name in ("loss", "excess"):
        low, median, high = (finite(value) for value in values[name])
        values[name] = {"lower_quartile": low, "median": median, "upper_quartile": high}
    return {name: finite(value) for name, value in values.items()}


def _flat(merit: Merit) -> dict[str, Any]:
    """As one row."""
    row: dict[str, Any] = {}
    for name, value in asdict(merit).items():
        if isinstance(value, tuple):
            row |= dict(zip(_spread_names(name), value, strict=True))
        else:
            row[name] = value
    return row


def _merit_columns() -> list[str]:
    columns: list[str] = []
    for one in fields(Merit):
        columns += _spread_names(one.name) if one.name in ("loss", "excess") else [one.name]
    return columns


def _spread_names(name: str) -> list[str]:
    return [f"{name}_lower_quartile", f"{name}_median", f"{name}_upper_quartile"]
