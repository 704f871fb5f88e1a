from pathlib import Path

import pytest

from cloudfit.comparison.experiment import Experiment, conduct, settings_of
from cloudfit.comparison.problems import load_problem
from cloudfit.comparison.run_record import RunRecord
from cloudfit.optimisers import OPTIMISERS, Budget
from render.errors import ParameterError
from tests.support.comparison import BowlSource, count_files


def experiment(out: Path, seeds: int = 2, evaluations: int = 30, methods: str = "genetic sbplx") -> Experiment:
    chosen = {name: OPTIMISERS[name] for name in methods.split()}
    return Experiment([BowlSource("one", 0.3), BowlSource("two", 0.6)], chosen, range(seeds), Budget(evaluations), out)


class Notes:
    """Remembers what it is told, and stops after some runs."""

    def __init__(self, stop_after: int = 1000) -> None:
        self.plan: tuple[int, int] | None = None
        self.done: list[RunRecord] = []
        self._stop_after = stop_after

    def planned(self, total: int, kept: int) -> None:
        self.plan = (total, kept)

    def stage(self, subject: str, share: float) -> None:
        assert 0.0 <= share <= 1.0
        if len(self.done) >= self._stop_after and "loss" in subject:
            raise KeyboardInterrupt

    def finished(self, record: RunRecord) -> None:
        self.done.append(record)


def test_every_method_runs_on_every_problem_from_every_seed(tmp_path: Path) -> None:
    report = conduct(experiment(tmp_path))
    assert (len(report.runs), report.kept, report.total, report.interrupted) == (8, 0, 8, False)
    assert count_files(tmp_path, "seed-*.json") == 8
    assert (tmp_path / "runs" / "one" / "genetic" / "seed-0001.json").is_file()
    assert {(run.problem, run.method, run.seed) for run in report.runs} == {
        (problem, method, seed) for problem in ("one", "two") for method in ("genetic", "sbplx") for seed in (0, 1)
    }
    assert not report.failed


def test_a_method_without_chance_runs_once_on_each_problem(tmp_path: Path) -> None:
    runs = conduct(experiment(tmp_path, seeds=3, methods="direct crs2_lm")).runs
    assert [(run.problem, run.seed) for run in runs if run.method == "direct"] == [("one", 0), ("two", 0)]
    assert sum(run.method == "crs2_lm" for run in runs) == 6


@pytest.mark.parametrize("name", ["direct", "direct_l", "orig_direct_l", "ags", "crs2_lm", "esch"])
def test_methods_without_chance_are_those_that_no_seed_changes(name: str) -> None:
    problem = load_problem(BowlSource("one", 0.3))
    method = OPTIMISERS[name]
    first, second = (method.minimise(problem.objective, problem.dimension, Budget(30), seed) for seed in (0, 7))
    assert first.evaluated.equal(second.evaluated) == getattr(method, "is_deterministic", False)


def test_what_is_finished_is_kept_and_only_what_is_new_is_run(tmp_path: Path) -> None:
    conduct(experiment(tmp_path))
    notes = Notes()
    report = conduct(experiment(tmp_path, seeds=3), listener=notes)
    assert notes.plan == (12, 8)
    assert {run.seed for run in notes.done} == {2}
    assert len(report.runs) == 12
    other = Notes()
    conduct(experiment(tmp_path, evaluations=31), listener=other)
    assert other.plan == (8, 0), "another budget is another question"


def test_ctrl_c_loses_the_run_under_way_alone(tmp_path: Path) -> None:
    report = conduct(experiment(tmp_path), listener=Notes(stop_after=3))
    assert report.interrupted
    assert len(report.runs) == count_files(tmp_path, "seed-*.json") == 3
    assert not list(tmp_path.rglob("*.part*"))
    notes = Notes()
    assert len(conduct(experiment(tmp_path), listener=notes).runs) == 8
    assert notes.plan == (8, 3)


def test_a_kept_run_is_the_run_that_would_be_done(tmp_path: Path) -> None:
    first = conduct(experiment(tmp_path / "a")).runs
    again = conduct(experiment(tmp_path / "b")).runs
    assert [run.loss for run in first] == [run.loss for run in again]
    assert first[0].trace.evaluation.tolist() == again[0].trace.evaluation.tolist()
    assert load_problem(BowlSource("one", 0.3)).name == "one"


def test_an_experiment_without_an_end_or_with_a_name_twice_is_refused(tmp_path: Path) -> None:
    methods = {"genetic": OPTIMISERS["genetic"]}
    with pytest.raises(ParameterError, match="limit"):
        Experiment([BowlSource("one")], methods, [0], Budget(), tmp_path)
    with pytest.raises(ParameterError, match="distinct"):
        Experiment([BowlSource("one"), BowlSource("one")], methods, [0], Budget(9), tmp_path)
    with pytest.raises(ParameterError, match="expected problems"):
        Experiment([], methods, [0], Budget(9), tmp_path)
    with pytest.raises(ParameterError, match="one job"):
        conduct(experiment(tmp_path), jobs=0)


def test_the_settings_of_a_method_do_not_depend_on_the_process() -> None:
    assert settings_of(OPTIMISERS["sbplx"]) == repr(OPTIMISERS["sbplx"])
    assert settings_of(OPTIMISERS["sbplx"]) != settings_of(OPTIMISERS["crs2_lm"])
    assert "0x" in repr(Notes())
    assert "0x" not in settings_of(Notes())  # type: ignore[arg-type]
