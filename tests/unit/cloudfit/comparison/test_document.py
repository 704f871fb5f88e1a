import csv
import json
from pathlib import Path

from cloudfit.comparison.analysis import Analysis
from cloudfit.comparison.document import Circumstances, describe_comparison, finite, write_csv, write_tables
from tests.support.comparison import facts, make_run

CIRCUMSTANCES = Circumstances(100, None, True, (0, 1), 1)


def analysis() -> Analysis:
    runs = [
        make_run("a", seed=0, steps=((1, 0.1, 2.0), (10, 1.0, 1.0))),
        make_run("a", seed=1, steps=((1, 0.1, 2.0), (10, 1.0, 1.0))),
        make_run("b", seed=0, steps=((1, 0.1, 2.0),)),
        make_run("b", seed=1, steps=(), failed=True, evaluations=0),
    ]
    return Analysis.of_runs(runs, [facts()], ["b", "a"], 100, None)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_document_is_json_without_infinities() -> None:
    document = describe_comparison(analysis(), CIRCUMSTANCES)
    json.dumps(document, allow_nan=False)
    assert document["settings"]["seeds"] == (0, 1)
    assert document["ranking_by_evaluations"] == ["a", "b"]
    by_name = {row["method"]: row for row in document["methods"]}
    assert by_name["a"]["loss"]["median"] == 1.0
    assert by_name["a"]["ert_evaluations"] == 10
    assert by_name["b"]["ert_evaluations"] is None
    assert by_name["b"]["loss"]["upper_quartile"] is None
    assert by_name["b"]["failed"] == 1
    (problem,) = document["problems"]
    assert (problem["best_loss"], problem["best_method"], problem["name"]) == (1.0, "a", "p")
    assert document["definitions"]["success_excess"] == 0.01


def test_the_tables_hold_the_same_numbers(tmp_path: Path) -> None:
    write_tables(tmp_path, analysis())
    runs = rows(tmp_path / "runs.csv")
    assert [(row["method"], row["seed"], row["loss"], row["excess"]) for row in runs] == [
        ("b", "0", "2.0", "1.0"),
        ("b", "1", "", ""),
        ("a", "0", "1.0", "0.0"),
        ("a", "1", "1.0", "0.0"),
    ]
    methods = {row["method"]: row for row in rows(tmp_path / "methods.csv")}
    assert methods["a"]["loss_median"] == "1.0"
    assert methods["b"]["ert_seconds"] == ""
    assert [row["problem"] for row in rows(tmp_path / "cells.csv")] == ["p", "p"]
    contrasts = rows(tmp_path / "contrasts.csv")
    assert [row["merit"] for row in contrasts] == ["aocc_evaluations", "aocc_seconds"]
    assert float(contrasts[0]["difference"]) < 0.0


def test_values_that_are_not_finite_are_left_empty(tmp_path: Path) -> None:
    write_csv(tmp_path / "t.csv", ("x", "y"), [{"x": float("nan"), "y": 2, "z": 3}])
    assert (tmp_path / "t.csv").read_text() == "x,y\n,2\n"
    assert finite(float("inf")) is None
    assert finite("word") == "word"
