"""The page of a comparison: its figures and tables, and the pictures behind the numbers."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch

from cloudfit.comparison.analysis import Analysis
from cloudfit.comparison.document import Circumstances, describe_comparison, write_tables
from cloudfit.comparison.figures import DRAWN_STRONGLY, figures
from cloudfit.comparison.iohprofiler import safe_name, write_ioh_logs
from cloudfit.comparison.problems import Problem
from cloudfit.comparison.run_record import RunRecord
from cloudfit.report import page_environment
from render.atomic_write import atomic_path
from render.image_files import write_png

PICTURES, LOGS = "pictures", "ioh"
"""Folders inside the output folder."""

Load = Callable[[str], Problem]
"""The problem of a name."""


def write_report(
    out: Path, analysis: Analysis, circumstances: Circumstances, load: Load
) -> tuple[Path, dict[str, Any]]:
    """Write comparison.json, the tables, the log for IOHanalyzer, the pictures and index.html.

    Args:
        out: folder; must exist.
        analysis: of the runs.
        circumstances: of the experiment.
        load: the problems, for the pictures.

    Returns:
        Path of the page, and the document of comparison.json.
    """
    document = describe_comparison(analysis, circumstances)
    with atomic_path(out / "comparison.json") as temporary:
        temporary.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    write_tables(out, analysis)
    write_ioh_logs(out / LOGS, analysis)
    pictures = write_pictures(out / PICTURES, analysis, load)
    html = page(document, figures(analysis), pictures)
    with atomic_path(out / "index.html") as temporary:
        temporary.write_text(html, encoding="utf-8")
    return out / "index.html", document


def page(document: Mapping[str, Any], drawn: Mapping[str, str], pictures: Mapping[str, Any]) -> str:
    """HTML that needs nothing but the pictures beside it.

    Args:
        document: of comparison.json.
        drawn: figures by name, from `figures`.
        pictures: from `write_pictures`.
    """
    methods = {row["method"]: row for row in document["methods"]}
    ranked = [methods[name] for name in document["ranking_by_evaluations"]]
    template = page_environment().get_template("comparison.html")
    return template.render(
        title="Optimisers compared",
        result=document,
        ranked=ranked,
        figures=drawn,
        pictures=pictures,
        drawn_strongly=DRAWN_STRONGLY,
        against_best=against_the_best(document),
        first=document["ranking_by_evaluations"][0],
    )


def against_the_best(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The best method by anytime area against each other, evaluations and seconds side by side, in the order of the ranking."""
    first = document["ranking_by_evaluations"][0]
    tables = [_toward(first, document[f"contrasts_aocc_{kind}"]) for kind in ("evaluations", "seconds")]
    return [
        {"method": name, "evaluations": tables[0].get(name), "seconds": tables[1].get(name)}
        for name in document["ranking_by_evaluations"][1:]
    ]


def _toward(first: str, contrasts: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Contrasts of one method with the others, turned so that it stands first."""
    found = {}
    for row in contrasts:
        if first not in (row["first"], row["second"]):
            continue
        turned = row["second"] == first
        sign = -1.0 if turned else 1.0
        low, high = sorted((sign * row["low"], sign * row["high"]))
        found[row["first"] if turned else row["second"]] = {
            "difference": sign * row["difference"],
            "low": low,
            "high": high,
            "wins": 1.0 - row["wins"] if turned else row["wins"],
            "p": row["p_corrected"],
        }
    return found


def write_pictures(folder: Path, analysis: Analysis, load: Load) -> dict[str, Any]:
    """Write the photographs, the best fit of each problem, and the best and the worst fit of each method.

    Args:
        folder: made if needed.
        analysis: of the runs.
        load: the problems.

    Returns:
        {"problems": {name: {...}}, "methods": {name: {"best": {...}, "worst": {...}}}} with the names of the files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    problems = {}
    for name, runs in analysis.problems.items():
        photograph = f"{safe_name(name)}-photograph.png"
        write_png(folder / photograph, load(name).fit.analysis.photograph.pixels.nan_to_num(0.0, 1.0, 0.0))
        problems[name] = {
            "photograph": f"{PICTURES}/{photograph}",
            **_fit_picture(folder, f"{safe_name(name)}-best.png", runs.winner, load),
        }
    methods = {}
    for method in analysis.methods:
        extremes = analysis.extreme_runs(method)
        if extremes is not None:
            methods[method] = {
                word: {
                    **_fit_picture(folder, f"{safe_name(method)}-{word}.png", run, load),
                    "photograph": problems[run.problem]["photograph"],
                }
                for word, run in zip(("best", "worst"), extremes, strict=True)
            }
    return {"problems": problems, "methods": methods}


def _fit_picture(folder: Path, name: str, run: RunRecord, load: Load) -> dict[str, Any]:
    image = load(run.problem).picture(torch.tensor(run.best))
    write_png(folder / name, image.nan_to_num(0.0, 1.0, 0.0))
    return {
        "file": f"{PICTURES}/{name}",
        "problem": run.problem,
        "method": run.method,
        "seed": run.seed,
        "loss": run.loss,
    }
