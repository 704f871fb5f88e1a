"""Runs as a log of IOHprofiler, to be read by IOHanalyzer and IOHinspector.

The format (https://iohprofiler.github.io/IOHanalyzer/data, version 0.3.3 and later of IOHexperimenter): for each algorithm a folder
with one JSON file for each function, which lists the runs and names the files with their evaluations. Such a file has a line of column
names before each run and then, separated by blanks, the evaluations that improved the loss and the last one. A run begins with evaluation
1. Evaluations that were no improvement are left out; the extra column is the wall time.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cloudfit.comparison.analysis import Analysis
from cloudfit.comparison.run_record import RunRecord
from render.atomic_write import atomic_path

FORMAT_VERSION = "0.3.18"
"""Version of IOHexperimenter whose format this is."""

SUITE = "cloudfit"

COLUMNS = ("evaluations", "raw_y", "seconds")


def write_ioh_logs(folder: Path, analysis: Analysis) -> None:
    """Write the runs of a comparison; problems are functions numbered from 1, seeds are instances numbered from 1.

    Args:
        folder: gets one folder for each method.
        analysis: of the runs.
    """
    for method in analysis.methods:
        for number, (name, problem) in enumerate(analysis.problems.items(), 1):
            runs = [run for run in problem.runs.get(method, ()) if run.evaluations]
            if runs:
                _write_function(folder / safe_name(method), method, number, name, problem.facts, runs)


def safe_name(name: str) -> str:
    """A name for folders and files: letters, digits, dots, pluses, minuses and underscores."""
    return re.sub(r"[^\w.+-]", "_", name)


def _write_function(
    folder: Path, method: str, number: int, name: str, facts: Mapping[str, Any], runs: Sequence[RunRecord]
) -> None:
    title, dimension = safe_name(name), int(facts["dimension"])
    data = Path(f"data_f{number}_{title}") / f"IOHprofiler_f{number}_DIM{dimension}.dat"
    document = {
        "version": FORMAT_VERSION,
        "suite": SUITE,
        "function_id": number,
        "function_name": title,
        "maximization": False,
        "algorithm": {"name": method, "info": "cloudfit compare"},
        "attributes": list(COLUMNS),
        "scenarios": [{"dimension": dimension, "path": data.as_posix(), "runs": [_describe(run) for run in runs]}],
    }
    (folder / data).parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(folder / data) as temporary:
        temporary.write_text("".join(_lines(run) for run in runs), encoding="utf-8")
    with atomic_path(folder / f"IOHprofiler_f{number}_{title}.json") as temporary:
        temporary.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _describe(run: RunRecord) -> dict[str, Any]:
    best = {"evals": int(run.trace.evaluation[-1]), "y": float(run.trace.loss[-1]), "x": list(run.best)}
    return {"instance": run.seed + 1, "evals": run.evaluations, "best": best}


def _lines(run: RunRecord) -> str:
    rows = list(zip(run.trace.evaluation, run.trace.loss, run.trace.seconds, strict=True))
    if rows[-1][0] < run.evaluations:
        rows.append((run.evaluations, rows[-1][1], run.seconds))
    lines = [f"{evaluation:.0f} {loss:.10g} {seconds:.6g}" for evaluation, loss, seconds in rows]
    return "\n".join([" ".join(COLUMNS), *lines]) + "\n"
