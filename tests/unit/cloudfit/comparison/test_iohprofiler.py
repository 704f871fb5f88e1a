import json
from pathlib import Path

from cloudfit.comparison.analysis import Analysis
from cloudfit.comparison.iohprofiler import safe_name, write_ioh_logs
from tests.support.comparison import facts, make_run


def test_the_log_has_the_form_that_iohanalyzer_reads(tmp_path: Path) -> None:
    runs = [
        make_run("a+b", "my p", seed=0, steps=((1, 0.5, 2.0), (10, 1.25, 1.0))),
        make_run("a+b", "my p", seed=1, steps=((1, 0.5, 3.0),), evaluations=1),
        make_run("a+b", "my p", seed=2, steps=(), failed=True, evaluations=0),
    ]
    write_ioh_logs(tmp_path, Analysis.of_runs(runs, [facts("my p")], ["a+b"], 100, None))
    document = json.loads((tmp_path / "a+b" / "IOHprofiler_f1_my_p.json").read_text())
    assert (document["function_id"], document["function_name"], document["maximization"]) == (1, "my_p", False)
    assert document["algorithm"]["name"] == "a+b"
    assert {"version", "suite", "attributes"} <= document.keys()
    (scenario,) = document["scenarios"]
    assert scenario["dimension"] == 2
    assert scenario["runs"] == [
        {"instance": 1, "evals": 100, "best": {"evals": 10, "y": 1.0, "x": [0.25, 0.5]}},
        {"instance": 2, "evals": 1, "best": {"evals": 1, "y": 3.0, "x": [0.25, 0.5]}},
    ]
    assert (tmp_path / "a+b" / scenario["path"]).read_text().splitlines() == [
        "evaluations raw_y seconds",
        "1 2 0.5",
        "10 1 1.25",
        "100 1 10",
        "evaluations raw_y seconds",
        "1 3 0.5",
    ]


def test_names_of_files_are_plain() -> None:
    assert safe_name("a/b c+d-e.1_f") == "a_b_c+d-e.1_f"
