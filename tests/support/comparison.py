"""Runs of a comparison made by hand, and problems that need no light transport."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from cloudfit.comparison.problems import Problem
from cloudfit.comparison.run_record import RunRecord, Trace
from cloudfit.fit_problem import FitProblem
from cloudfit.parameters import Parameter, SearchSpace

SPACE = SearchSpace((Parameter("x", "x", "1", 0.0, 2.0), Parameter("y", "y", "1", 0.0, 1.0)))


def trace(*steps: tuple[float, float, float]) -> Trace:
    """Trace of (evaluation, seconds, loss)."""
    table = np.array(steps, float).reshape(-1, 3)
    return Trace(table[:, 0], table[:, 1], table[:, 2])


def make_run(
    method: str = "a",
    problem: str = "p",
    seed: int = 0,
    steps: Sequence[tuple[float, float, float]] = ((1, 0.1, 1.0),),
    evaluations: int = 100,
    seconds: float = 10.0,
    failed: bool = False,
) -> RunRecord:
    """A run whose answer is the last of its steps."""
    return RunRecord(
        fingerprint="f",
        problem=problem,
        method=method,
        seed=seed,
        failed=failed,
        message="",
        starts=1,
        evaluations=evaluations,
        seconds=seconds,
        objective_seconds=0.75 * seconds,
        best=(0.25, 0.5) if steps else (),
        parameters={"x": 0.5, "y": 0.5} if steps else {},
        loss=steps[-1][2] if steps else float("inf"),
        threads=1,
        trace=trace(*steps),
    )


def facts(name: str = "p", floor: float = 0.1) -> dict[str, Any]:
    """Of a problem of two parameters."""
    return {
        "name": name,
        "dimension": 2,
        "floor": floor,
        "pixels": 50,
        "truth": None,
        "truth_loss": None,
        "warnings": [],
    }


class Bowl:
    """Stands in for the objective of a photograph: the squared distance from a point, and 0.2."""

    def __init__(self, place: float = 0.3) -> None:
        self.place = place
        self.space = SPACE
        self.floor = 0.1
        self.counted = torch.arange(50)
        self.analysis = SimpleNamespace(
            warnings=(), photograph=SimpleNamespace(pixels=torch.full((3, 4, 3), 0.5)), sky=torch.zeros(3, 4, 3)
        )
        self.asked = 0

    def evaluate(self, population: Tensor) -> Tensor:
        self.asked += len(population)
        return 0.2 + (population.double() - self.place).square().sum(1)

    __call__ = evaluate


class BowlProblem(Problem):
    """A problem that is a bowl."""

    def picture(self, unit: Tensor) -> Tensor:
        return torch.full((3, 4, 3), float(unit[0]))


def bowl_problem(name: str = "bowl", place: float = 0.3) -> Problem:
    """A problem whose best loss of 0.2 lies at a place."""
    return BowlProblem(name, cast(FitProblem, Bowl(place)), torch.full((2,), place))


@dataclass(frozen=True)
class BowlSource:
    """Source of a bowl; can be sent to another process."""

    name: str
    place: float = 0.3

    def fingerprint(self) -> str:
        return f"{self.place:064.3f}"

    def load(self) -> Problem:
        return bowl_problem(self.name, self.place)


def count_files(folder: Path, pattern: str) -> int:
    """Files below a folder."""
    return len(list(folder.rglob(pattern)))
