import json
from pathlib import Path

import pytest

from cloudfit.comparison.analysis import Analysis
from cloudfit.comparison.document import Circumstances, describe_comparison
from cloudfit.comparison.page import against_the_best, write_report
from cloudfit.comparison.problems import Problem
from tests.support.comparison import bowl_problem, facts, make_run

CIRCUMSTANCES = Circumstances(100, None, True, (0, 1), 2)
GOOD = ((1, 0.1, 2.0), (10, 1.0, 1.0))


def analysis() -> Analysis:
    runs = [
        make_run(method, problem, seed, GOOD if method == "a<b" else ((1, 0.1, 2.0 - 0.1 * seed),))
        for problem in ("p", "q")
        for method in ("other", "a<b")
        for seed in (0, 1)
    ]
    return Analysis.of_runs(runs, [facts("p"), facts("q")], ["other", "a<b"], 100, None)


def load(name: str) -> Problem:
    return bowl_problem(name)


def test_the_report_is_a_page_with_its_pictures_numbers_and_logs(tmp_path: Path) -> None:
    page, document = write_report(tmp_path, analysis(), CIRCUMSTANCES, load)
    html = page.read_text(encoding="utf-8")
    assert "a&lt;b" in html
    assert "a<b" not in html
    assert html.count("<svg") == 6
    assert "2 runs at a time" in html
    assert "Fewer than 15 runs" in html
    for name in ("p-photograph.png", "q-best.png", "a_b-best.png", "a_b-worst.png", "other-worst.png"):
        assert (tmp_path / "pictures" / name).is_file()
        assert f"pictures/{name}" in html
    assert json.loads((tmp_path / "comparison.json").read_text())["ranking_by_seconds"] == ["a<b", "other"]
    assert document["ranking_by_evaluations"] == ["a<b", "other"]
    assert all((tmp_path / name).is_file() for name in ("runs.csv", "cells.csv", "methods.csv", "contrasts.csv"))
    assert (tmp_path / "ioh" / "other" / "IOHprofiler_f2_q.json").is_file()


def test_the_best_method_stands_first_in_its_contrasts() -> None:
    document = describe_comparison(analysis(), CIRCUMSTANCES)
    (row,) = against_the_best(document)
    assert row["method"] == "other"
    stored = document["contrasts_aocc_evaluations"][0]
    assert (stored["first"], stored["second"]) == ("other", "a<b")
    assert row["evaluations"]["difference"] == pytest.approx(-stored["difference"])
    assert row["evaluations"]["difference"] > 0.0
    assert row["evaluations"]["low"] <= row["evaluations"]["difference"] <= row["evaluations"]["high"]
    assert row["evaluations"]["wins"] == 1.0
