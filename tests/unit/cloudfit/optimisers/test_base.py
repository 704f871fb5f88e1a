"""Budgets, the evaluation log and the ways in which a run can end."""

import math
import time

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers.base import (
    PENALTY,
    Budget,
    EvaluationLog,
    StopReason,
    check_start,
    penalise,
    pool_results,
    run_logged,
    seeded_generator,
)
from render.errors import ParameterError


def first_column(population: Tensor) -> Tensor:
    return population[:, 0]


def evaluate_batches(*batches: Tensor):  # type: ignore[no-untyped-def]
    """A search that evaluates these batches and then says that it has converged."""

    def search(log: EvaluationLog) -> StopReason:
        for batch in batches:
            log.evaluate(batch)
        return StopReason.CONVERGED

    return search


BATCHES = torch.tensor([[[0.5], [0.7]], [[0.4], [0.9]], [[0.6], [0.3]]])


def test_record_of_a_run() -> None:
    reports: list[tuple[int, int, float]] = []
    result = run_logged(
        evaluate_batches(*BATCHES), first_column, 1, Budget(), lambda *report: reports.append((*report,))
    )
    assert result.stop_reason is StopReason.CONVERGED
    assert result.evaluations == 6
    assert result.iterations == 3
    assert result.best_loss == pytest.approx(0.3)
    assert torch.equal(result.best, torch.tensor([0.3]))
    torch.testing.assert_close(result.history, torch.tensor([0.5, 0.4, 0.3]).double())
    assert torch.equal(result.evaluated, BATCHES.reshape(6, 1))
    assert torch.equal(result.losses, BATCHES.reshape(6).double())
    assert [report[:2] for report in reports] == [(1, 2), (2, 4), (3, 6)]
    assert [report[2] for report in reports] == pytest.approx([0.5, 0.4, 0.3])
    assert result.message == ""


def test_a_batch_that_does_not_fit_the_budget_is_cut() -> None:
    sizes: list[int] = []

    def count(population: Tensor) -> Tensor:
        sizes.append(len(population))
        return population[:, 0]

    result = run_logged(evaluate_batches(*BATCHES), count, 1, Budget(evaluations=3))
    assert sizes == [2, 1]
    assert result.stop_reason is StopReason.EVALUATIONS
    assert result.best_loss == pytest.approx(0.4)


def test_target_ends_at_once_and_includes_equality() -> None:
    result = run_logged(evaluate_batches(*BATCHES), first_column, 1, Budget(target=0.5))
    assert (result.stop_reason, result.iterations) == (StopReason.TARGET, 1)
    result = run_logged(evaluate_batches(*BATCHES), first_column, 1, Budget(target=0.45))
    assert (result.stop_reason, result.iterations) == (StopReason.TARGET, 2)


def test_time_is_checked_before_each_batch_and_buys_one_at_least() -> None:
    def slow(population: Tensor) -> Tensor:
        time.sleep(0.02)
        return population[:, 0]

    result = run_logged(evaluate_batches(*BATCHES), slow, 1, Budget(seconds=1e-9))
    assert (result.stop_reason, result.iterations) == (StopReason.SECONDS, 1)
    assert result.seconds >= 0.02


def test_points_are_moved_into_the_cube_and_protected_from_the_objective() -> None:
    def spoil(population: Tensor) -> Tensor:
        losses = population.sum(dim=1)
        population.fill_(7.0)
        return losses

    batch = torch.tensor([[-0.5, 1.5]], dtype=torch.float64)
    result = run_logged(evaluate_batches(batch), spoil, 2, Budget())
    assert torch.equal(result.best, torch.tensor([0.0, 1.0]))
    assert torch.equal(batch, torch.tensor([[-0.5, 1.5]], dtype=torch.float64))


def test_penalty_replaces_everything_that_is_not_finite() -> None:
    losses = torch.tensor([0.5, math.nan, math.inf, -math.inf, -3.0, 1e30])
    assert penalise(losses).tolist() == [0.5, PENALTY, PENALTY, PENALTY, -3.0, PENALTY]
    assert penalise(losses.requires_grad_()).dtype == torch.float64


def test_a_run_without_a_finite_loss_says_so() -> None:
    result = run_logged(evaluate_batches(*BATCHES), lambda population: population[:, 0] * math.nan, 1, Budget())
    assert result.best_loss == PENALTY
    assert "finite" in result.message


@pytest.mark.parametrize(
    ("error", "reason"), [(KeyboardInterrupt(), "INTERRUPTED"), (ValueError("sun went out"), "FAILED")]
)
@pytest.mark.parametrize("place", ["objective", "search", "progress"])
def test_whatever_ends_a_run_the_best_so_far_is_kept(error: BaseException, reason: str, place: str) -> None:
    calls = 0

    def break_at_third(where: str) -> None:
        nonlocal calls
        if where == place:
            calls += 1
            if calls == 3:
                raise error

    def objective(population: Tensor) -> Tensor:
        break_at_third("objective")
        return population[:, 0]

    def search(log: EvaluationLog) -> StopReason:
        for batch in BATCHES:
            break_at_third("search")
            log.evaluate(batch)
        return StopReason.CONVERGED

    result = run_logged(search, objective, 1, Budget(), lambda *_: break_at_third("progress"))
    assert result.stop_reason is StopReason[reason]
    assert result.best_loss == pytest.approx(0.3 if place == "progress" else 0.4)
    assert result.message == ("ValueError: sun went out" if reason == "FAILED" else "")


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ValueError("sun went out")])
def test_without_any_evaluation_there_is_no_result(error: BaseException) -> None:
    def fail(_: Tensor) -> Tensor:
        raise error

    with pytest.raises(type(error)):
        run_logged(evaluate_batches(*BATCHES), fail, 1, Budget())


def test_shape_of_the_losses_is_checked() -> None:
    with pytest.raises(ParameterError, match=r"shape \(2, 1\) for points \(2, 1\).*\(2,\)"):
        run_logged(evaluate_batches(*BATCHES), lambda population: population, 1, Budget())


def test_reasons_are_sentences() -> None:
    for reason in StopReason:
        assert reason.value[0].isupper()
        assert reason.value.endswith(".")


def test_impossible_arguments_are_named() -> None:
    for keywords in ({"evaluations": 0}, {"seconds": 0.0}, {"seconds": math.nan}, {"target": math.nan}):
        with pytest.raises(ParameterError, match="expected a"):
            Budget(**keywords)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="got -1"):
        seeded_generator(-1)
    with pytest.raises(ParameterError, match=r"shape \(2,\)"):
        check_start(torch.zeros(3), 2)
    with pytest.raises(ParameterError, match="finite"):
        check_start(torch.tensor([0.0, math.nan]), 2)
    with pytest.raises(ParameterError, match="at least one parameter"):
        run_logged(evaluate_batches(*BATCHES), first_column, 0, Budget())


def test_start_is_moved_into_the_cube() -> None:
    start = check_start(torch.tensor([-1.0, 0.25]), 2)
    assert start is not None
    assert start.tolist() == [0.0, 0.25]
    assert check_start(None, 2) is None


def test_times_are_those_at_which_losses_were_known() -> None:
    def slow(population: Tensor) -> Tensor:
        time.sleep(0.02)
        return population[:, 0]

    def search(log: EvaluationLog) -> StopReason:
        log.evaluate(BATCHES[0])
        time.sleep(0.05)
        log.evaluate(BATCHES[1])
        return StopReason.CONVERGED

    result = run_logged(search, slow, 1, Budget())
    assert result.times.dtype == torch.float64
    assert result.times[0] == result.times[1] >= 0.02
    assert result.times[2] == result.times[3] >= result.times[1] + 0.07
    # Sleep is never shorter than asked for; what the search itself took is not the objective's.
    assert 0.04 <= result.objective_seconds <= result.seconds - 0.05


def test_pooled_runs_follow_each_other() -> None:
    first, second = (run_logged(evaluate_batches(batch), first_column, 1, Budget()) for batch in BATCHES[:2])
    pooled = pool_results([first, second])
    torch.testing.assert_close(pooled.times, torch.cat([first.times, first.seconds + second.times]))
    assert bool((pooled.times.diff() >= 0).all())
    assert float(pooled.times[-1]) <= pooled.seconds == first.seconds + second.seconds
    assert pooled.objective_seconds == first.objective_seconds + second.objective_seconds
    assert pooled.history.tolist() == pytest.approx([0.5, 0.4])


class Slope:
    """A plane with holes: not a number below 0.35, without a slope above 0.85."""

    def __call__(self, population: Tensor) -> Tensor:
        return torch.where(population[:, 0] < 0.35, math.nan, 3.0 * population[:, 0])

    def with_gradient(self, population: Tensor) -> tuple[Tensor, Tensor]:
        return self(population), torch.where(population > 0.85, math.inf, 3.0)


def test_gradients_are_recorded_like_losses_and_made_finite() -> None:
    seen: list[tuple[Tensor, Tensor]] = []

    def search(log: EvaluationLog) -> StopReason:
        seen.append(log.evaluate_with_gradient(torch.tensor([[0.3], [0.5], [0.9]])))
        log.evaluate_with_gradient(torch.tensor([[0.4], [0.6]]))
        return StopReason.CONVERGED

    result = run_logged(search, Slope(), 1, Budget(evaluations=4))
    losses, gradient = seen[0]
    assert losses.tolist() == pytest.approx([PENALTY, 1.5, 2.7])
    assert gradient.tolist() == [[0.0], [3.0], [0.0]]
    assert (result.stop_reason, result.evaluations, result.iterations) == (StopReason.EVALUATIONS, 4, 2)
    assert result.best_loss == pytest.approx(1.2)


def test_an_objective_without_a_gradient_is_refused() -> None:
    with pytest.raises(ParameterError, match="choose a differentiable loss"):
        run_logged(
            lambda log: log.evaluate_with_gradient(BATCHES[0]) and StopReason.CONVERGED, first_column, 1, Budget()
        )

    class Flat(Slope):
        def with_gradient(self, population: Tensor) -> tuple[Tensor, Tensor]:
            return self(population), population[:, 0]

    with pytest.raises(ParameterError, match=r"shape \(2, 1\), got \(2,\)"):
        run_logged(lambda log: log.evaluate_with_gradient(BATCHES[0]) and StopReason.CONVERGED, Flat(), 1, Budget())
