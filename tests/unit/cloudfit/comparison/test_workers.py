import os
from dataclasses import dataclass
from pathlib import Path

import pytest
from torch import Tensor

from cloudfit.comparison.experiment import Experiment, conduct
from cloudfit.comparison.workers import DIED
from cloudfit.optimisers import OPTIMISERS, Budget
from cloudfit.optimisers.base import Objective, OptimiserResult, Progress
from tests.support.comparison import BowlSource


@dataclass(frozen=True)
class Deadly:
    """Takes its process down."""

    def minimise(
        self,
        objective: Objective,
        dimension: int,
        budget: Budget,
        seed: int,
        on_progress: Progress | None = None,
        start: Tensor | None = None,
    ) -> OptimiserResult:
        os._exit(3)


@pytest.mark.parametrize("deadly", [False, True])
def test_processes_do_the_same_runs_and_survive_one_that_dies(tmp_path: Path, deadly: bool) -> None:
    methods = {"genetic": OPTIMISERS["genetic"], **({"deadly": Deadly()} if deadly else {})}

    def experiment(out: Path) -> Experiment:
        return Experiment([BowlSource("one"), BowlSource("two", 0.7)], methods, [0], Budget(25), out)

    report = conduct(experiment(tmp_path / "two"), jobs=2)
    assert len(report.runs) == report.total == 2 * len(methods)
    assert [run.method for run in report.failed] == ["deadly"] * (2 if deadly else 0)
    assert all(run.message == DIED for run in report.failed)
    if not deadly:
        alone = conduct(experiment(tmp_path / "one"))
        assert [run.loss for run in report.runs] == [run.loss for run in alone.runs]
    assert len(conduct(experiment(tmp_path / "two"), jobs=2).runs) == report.total, "nothing is done twice"
