"""Runs that share a budget."""

import time

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers.base import Budget, EvaluationLog, OptimiserResult, Progress, StopReason, run_logged
from cloudfit.optimisers.relay import Leg, Relay


def evaluate(values: list[float], reason: StopReason = StopReason.CONVERGED, error: BaseException | None = None) -> Leg:
    """A run over points one by one, whose losses are the points."""

    def search(log: EvaluationLog) -> StopReason:
        for value in values:
            log.evaluate(torch.tensor([[value]]))
        if error is not None:
            raise error
        return reason

    def first_column(population: Tensor) -> Tensor:
        return population[:, 0]

    def leg(budget: Budget, report: Progress) -> OptimiserResult:
        return run_logged(search, first_column, 1, budget, report)

    return leg


def test_totals_and_the_best_are_those_of_all_runs() -> None:
    reports: list[tuple[int, int, float]] = []
    relay = Relay(Budget(), lambda *report: reports.append(report))
    assert relay.run(evaluate([0.5, 0.25]))
    assert relay.run(evaluate([0.75, 0.5]))
    result = relay.result()
    assert (result.evaluations, result.best_loss, result.stop_reason) == (4, 0.25, StopReason.CONVERGED)
    assert reports == [(1, 1, 0.5), (2, 2, 0.25), (3, 3, 0.25), (4, 4, 0.25)]
    assert result.history.tolist() == [0.5, 0.25, 0.25, 0.25]


def test_a_share_of_what_is_left_and_then_nothing() -> None:
    relay = Relay(Budget(evaluations=4), None)
    assert relay.run(evaluate([0.5] * 9), share=0.5)
    assert relay.results[0].evaluations == 2
    relay.run(evaluate([0.4] * 9))
    assert [result.evaluations for result in relay.results] == [2, 2]
    assert not relay.run(evaluate([0.3]))
    assert (relay.result().stop_reason, relay.result().evaluations) == (StopReason.EVALUATIONS, 4)


def test_time_is_that_of_the_relay() -> None:
    def sleep(budget: Budget, report: Progress) -> OptimiserResult:
        time.sleep(0.03)
        return evaluate([0.5])(budget, report)

    relay = Relay(Budget(seconds=0.02), None)
    assert relay.run(sleep)
    assert not relay.run(evaluate([0.1]))
    assert relay.result().stop_reason is StopReason.SECONDS
    assert relay.result().best_loss == 0.5


@pytest.mark.parametrize("reason", [StopReason.TARGET, StopReason.INTERRUPTED, StopReason.FAILED])
def test_final_reasons_end_the_relay(reason: StopReason) -> None:
    relay = Relay(Budget(), None)
    assert not relay.run(evaluate([0.5], reason))
    assert relay.result().stop_reason is reason


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ValueError("dark")])
def test_an_error_before_the_first_point_of_a_later_run_keeps_the_earlier(error: BaseException) -> None:
    relay = Relay(Budget(), None)
    with pytest.raises(type(error)):
        relay.run(evaluate([], error=error))
    assert relay.run(evaluate([0.5]))
    assert not relay.run(evaluate([], error=error))
    result = relay.result()
    assert result.best_loss == 0.5
    assert result.stop_reason is (StopReason.FAILED if isinstance(error, ValueError) else StopReason.INTERRUPTED)
    assert result.message == ("ValueError: dark" if isinstance(error, ValueError) else "")
