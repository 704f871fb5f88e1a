"""What the adapter guards against, each shown to be there without it."""

import math
from collections.abc import Callable

import nlopt
import numpy as np
import pytest
import torch
from torch import Tensor

from cloudfit.optimisers.base import Budget, EvaluationLog, StopReason
from cloudfit.optimisers.nlopt_adapter import CRASH_PRONE, NLOPT_ALGORITHMS, NloptMinimiser
from render.errors import ParameterError


def bowl(population: Tensor) -> Tensor:
    return ((population - 0.3) ** 2).sum(dim=1)


def test_nothing_is_evaluated_after_the_end_although_crs2_goes_on_asking() -> None:
    asked = 0

    def fail_late(population: Tensor) -> Tensor:
        nonlocal asked
        asked += 1
        if asked == 5:
            raise KeyboardInterrupt
        return bowl(population)

    result = NloptMinimiser("crs2_lm").minimise(fail_late, 5, Budget(), 1)
    assert result.stop_reason is StopReason.INTERRUPTED
    assert (asked, result.evaluations) == (5, 4)

    calls = 0
    solver = nlopt.opt(nlopt.GN_CRS2_LM, 5)
    solver.set_lower_bounds(np.zeros(5))
    solver.set_upper_bounds(np.ones(5))

    def stop_at_five(x: np.ndarray, gradient: np.ndarray) -> float:
        nonlocal calls
        calls += 1
        if calls == 5:
            solver.force_stop()
        return float(x.sum())

    solver.set_min_objective(stop_at_five)
    with pytest.raises(nlopt.ForcedStop):
        solver.optimize(np.full(5, 0.5))
    assert calls > 5


@pytest.mark.parametrize("name", NLOPT_ALGORITHMS)
def test_recorded_points_are_copies(name: str) -> None:
    result = NloptMinimiser(name).minimise(bowl, 3, Budget(evaluations=60), 1)
    torch.testing.assert_close(bowl(result.evaluated).double(), result.losses, rtol=1e-6, atol=1e-7)
    # Views of one buffer would all be equal.
    assert len(result.evaluated.unique(dim=0)) > 10


def test_direct_l_gives_up_on_nan_without_the_penalty() -> None:
    def hole(population: Tensor) -> Tensor:
        return torch.where(population[:, 0] < 0.2, math.nan, bowl(population))

    result = NloptMinimiser("direct_l").minimise(hole, 2, Budget(evaluations=400), 1)
    assert result.evaluations == 400
    assert result.best_loss < 1e-3

    solver = nlopt.opt(nlopt.GN_DIRECT_L, 2)
    solver.set_lower_bounds(np.zeros(2))
    solver.set_upper_bounds(np.ones(2))
    solver.set_maxeval(400)
    solver.set_min_objective(lambda x, gradient: math.nan)
    # In some versions this is not a RuntimeError.
    with pytest.raises(nlopt.runtime_error):
        solver.optimize(np.full(2, 0.5))


ENDLESS = [(name, None) for name in ("isres", "esch", "direct", "direct_l", "orig_direct_l", "ags")]


@pytest.mark.parametrize(("name", "local"), [*ENDLESS, ("mlsl", "bobyqa"), ("mlsl_lds", "sbplx")])
def test_methods_that_never_stop_get_a_limit(name: str, local: str | None) -> None:
    result = NloptMinimiser(name, local, largest_evaluations=123).minimise(bowl, 3, Budget(), 1)
    assert (result.stop_reason, result.evaluations) == (StopReason.EVALUATIONS, 123)
    result = NloptMinimiser(name, local, largest_evaluations=123).minimise(bowl, 3, Budget(evaluations=140), 1)
    assert result.evaluations == 140


def test_orig_direct_l_asks_for_more_than_it_may_have() -> None:
    calls = 0

    def count(x: np.ndarray, gradient: np.ndarray) -> float:
        nonlocal calls
        calls += 1
        return float(((x - 0.3) ** 2).sum())

    solver = nlopt.opt(nlopt.GN_ORIG_DIRECT_L, 3)
    solver.set_lower_bounds(np.zeros(3))
    solver.set_upper_bounds(np.ones(3))
    solver.set_maxeval(123)
    solver.set_min_objective(count)
    solver.optimize(np.full(3, 0.5))
    assert calls > 123


@pytest.mark.parametrize("name", NLOPT_ALGORITHMS)
def test_a_failure_of_the_first_evaluation_is_raised_again_and_again(name: str) -> None:
    # In the same process ORIG_DIRECT_L survives this a few times at most, with eight parameters hardly ever.
    def fail(population: Tensor) -> Tensor:
        raise ValueError("dark")

    for _ in range(3 if name in CRASH_PRONE else 20):
        with pytest.raises(ValueError, match="dark"):
            NloptMinimiser(name).minimise(fail, 8, Budget(), 1)


def test_a_crash_of_ags_is_a_failure_that_keeps_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    # With the penalty AGS does not crash; without it, it does, and takes its own process along.
    monkeypatch.setattr(EvaluationLog, "evaluate", spoil(EvaluationLog.evaluate, after=30))
    result = NloptMinimiser("ags").minimise(bowl, 5, Budget(evaluations=200), 1)
    assert result.stop_reason is StopReason.FAILED
    assert result.message.startswith("RuntimeError: ags crashed with SIG")
    assert 30 < result.evaluations < 200
    assert result.best_loss == float(result.losses.min()) < 0.5


def spoil(evaluate: Callable[..., Tensor], after: int) -> Callable[..., Tensor]:
    """An evaluation that answers NaN from some point on."""

    def spoilt(log: EvaluationLog, population: Tensor) -> Tensor:
        losses = evaluate(log, population)
        return losses if log.evaluations <= after else losses * math.nan

    return spoilt


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_ags_works_on_with_the_penalty(bad: float) -> None:
    def hole(population: Tensor) -> Tensor:
        return torch.where(population[:, 0] > 0.6, bad, bowl(population))

    result = NloptMinimiser("ags").minimise(hole, 5, Budget(evaluations=300), 1)
    assert (result.stop_reason, result.evaluations) == (StopReason.EVALUATIONS, 300)
    assert result.best_loss < 0.2


def test_ags_refuses_more_parameters_than_its_curve_reaches() -> None:
    assert NloptMinimiser("ags").minimise(bowl, 10, Budget(evaluations=50), 1).evaluations == 50
    with pytest.raises(ParameterError, match="at most 10 parameters, got 11"):
        NloptMinimiser("ags").minimise(bowl, 11, Budget(evaluations=50), 1)


def test_mlsl_finds_the_better_of_two_valleys_and_needs_a_local_method() -> None:
    def valleys(population: Tensor) -> Tensor:
        return torch.minimum(bowl(population) + 0.05, 4.0 * ((population - 0.8) ** 2).sum(dim=1))

    start = torch.full((3,), 0.3)
    alone = NloptMinimiser("bobyqa").minimise(valleys, 3, Budget(), 1, start=start)
    many = NloptMinimiser("mlsl_lds", "bobyqa").minimise(valleys, 3, Budget(evaluations=500), 1, start=start)
    assert alone.best_loss == pytest.approx(0.05, abs=1e-3)
    assert many.best_loss < 1e-3
    for name, local in (("mlsl", None), ("mlsl", "direct"), ("direct", "bobyqa")):
        with pytest.raises(ParameterError, match="expected a local method"):
            NloptMinimiser(name, local)


@pytest.mark.parametrize("name", ["sbplx", "bobyqa", "cobyla", "nelder_mead", "crs2_lm"])
def test_methods_that_converge_say_so_and_obey_the_tolerance(name: str) -> None:
    coarse, fine = (
        NloptMinimiser(name, tolerance=tolerance).minimise(bowl, 3, Budget(), 1) for tolerance in (0.03, 1e-5)
    )
    assert coarse.stop_reason is fine.stop_reason is StopReason.CONVERGED
    assert coarse.evaluations < fine.evaluations
    torch.testing.assert_close(fine.best, torch.full((3,), 0.3), rtol=0, atol=1e-3)


def test_the_stream_of_random_numbers_is_reset_for_every_run() -> None:
    method = NloptMinimiser("crs2_lm")
    start = torch.full((3,), 0.5)
    first = method.minimise(bowl, 3, Budget(evaluations=50), 5, start=start)
    method.minimise(bowl, 3, Budget(evaluations=17), 6, start=start)
    assert torch.equal(method.minimise(bowl, 3, Budget(evaluations=50), 5, start=start).evaluated, first.evaluated)
    assert not torch.equal(method.minimise(bowl, 3, Budget(evaluations=50), 6, start=start).evaluated, first.evaluated)


def test_the_initial_step_is_the_distance_of_the_first_points() -> None:
    start = torch.full((4,), 0.5)
    near, far = (
        NloptMinimiser("sbplx", initial_step=step).minimise(bowl, 4, Budget(evaluations=5), 1, start=start)
        for step in (0.02, 0.3)
    )
    assert float((near.evaluated - start).abs().max()) < 0.1 < float((far.evaluated - start).abs().max())


@pytest.mark.parametrize("corner", [0.0, 1.0])
@pytest.mark.parametrize("name", ["sbplx", "bobyqa", "cobyla", "nelder_mead"])
def test_local_methods_start_and_end_at_bounds(name: str, corner: float) -> None:
    towards = 1 - 2 * corner

    def slope(population: Tensor) -> Tensor:
        return towards * population.sum(dim=1)

    result = NloptMinimiser(name).minimise(slope, 3, Budget(evaluations=300), 1, start=torch.full((3,), corner))
    assert torch.equal(result.best, torch.full((3,), corner))


def test_impossible_hyper_parameters_are_refused() -> None:
    with pytest.raises(ParameterError, match="'gn_ags'"):
        NloptMinimiser("gn_ags")
    for keywords in ({"tolerance": 0.0}, {"initial_step": 2.0}, {"largest_evaluations": 0}):
        with pytest.raises(ParameterError, match="expected tolerance"):
            NloptMinimiser("sbplx", **keywords)  # type: ignore[arg-type]
