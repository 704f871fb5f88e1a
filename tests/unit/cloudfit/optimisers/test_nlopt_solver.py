"""NLopt in this process and in one of its own give the same, and only the latter may crash."""

import io
import math
import struct
import subprocess
from typing import Any

import numpy as np
import pytest

from cloudfit.optimisers.nlopt_adapter import CRASH_PRONE
from cloudfit.optimisers.nlopt_solver import ALGORITHMS, Search, serve, solve, solve_apart


def search_with(algorithm: str, **changes: object) -> Search:
    settings: dict[str, object] = {
        "algorithm": algorithm,
        "local": "bobyqa" if algorithm.startswith("mlsl") else None,
        "start": (0.9, 0.4, 0.6),
        "tolerance": 1e-4,
        "local_tolerance": 1e-3,
        "initial_step": 0.2,
        "evaluations": 80,
        "seed": 3,
    }
    return Search(**{**settings, **changes})  # type: ignore[arg-type]


class Bowl:
    def __init__(self, ends_after: int | None = None) -> None:
        self.points: list[np.ndarray] = []
        self.ends_after = ends_after

    def __call__(self, x: np.ndarray) -> float | None:
        self.points.append(x)
        if len(self.points) == self.ends_after:
            return None
        return float(((x - 0.3) ** 2).sum())


@pytest.mark.parametrize("algorithm", ["crs2_lm", "sbplx", "ags", "mlsl"])
def test_a_process_of_its_own_changes_nothing(algorithm: str) -> None:
    here, there = Bowl(), Bowl()
    solve(search_with(algorithm), here)
    solve_apart(search_with(algorithm), there)
    assert len(here.points) > 20
    np.testing.assert_array_equal(here.points, there.points)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_none_ends_the_search_at_once(algorithm: str) -> None:
    bowl = Bowl(ends_after=7)
    run = solve_apart if algorithm in CRASH_PRONE else solve
    run(search_with(algorithm, evaluations=10**6), bowl)
    assert len(bowl.points) == 7


def test_none_ends_the_search_apart() -> None:
    bowl = Bowl(ends_after=7)
    solve_apart(search_with("ags"), bowl)
    assert len(bowl.points) == 7


def test_points_are_copies() -> None:
    bowl = Bowl()
    solve(search_with("sbplx"), bowl)
    assert len({point.tobytes() for point in bowl.points}) > 20


def test_a_crash_stays_in_its_process() -> None:
    with pytest.raises(RuntimeError, match="ags crashed with SIG"):
        solve_apart(search_with("ags"), lambda x: math.nan)


def test_a_process_that_is_killed_while_a_loss_is_computed_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []

    class Remembered(subprocess.Popen[bytes]):
        def __init__(self, *arguments: Any, **keywords: Any) -> None:
            super().__init__(*arguments, **keywords)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Remembered)

    def kill_at_third(x: np.ndarray) -> float:
        calls.append(x)
        if len(calls) == 3:
            started[0].kill()
            started[0].wait()
        return float(x.sum())

    calls: list[np.ndarray] = []
    with pytest.raises(RuntimeError, match="ags crashed with SIGKILL"):
        solve_apart(search_with("ags"), kill_at_third)
    assert len(calls) == 3


def test_an_error_of_the_solver_is_reported() -> None:
    with pytest.raises(RuntimeError, match="ags gave up with exit code 1"):
        solve_apart(search_with("ags", start=(0.5,) * 11), Bowl())


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ValueError("dark")])
def test_an_error_of_the_losses_comes_through_and_ends_the_process(error: BaseException) -> None:
    def fail(x: np.ndarray) -> float:
        raise error

    with pytest.raises(type(error)):
        solve_apart(search_with("ags"), fail)


def test_the_served_end_writes_points_and_stops_where_the_answers_end() -> None:
    questions, answers = io.BytesIO(), io.BytesIO(struct.pack("3d", 3.0, 2.0, 1.0))
    serve(search_with("sbplx"), questions, answers)
    points = np.frombuffer(questions.getvalue()).reshape(-1, 3)
    # Three answers, and the question that got none.
    assert len(points) == 4
    np.testing.assert_array_equal(points[0], (0.9, 0.4, 0.6))
