"""A global search and a local one as one."""

import time
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers import AskTellMinimiser, Budget, GeneticAlgorithm, NloptMinimiser, Polished, StopReason
from render.errors import ParameterError

GENETIC = AskTellMinimiser(GeneticAlgorithm())
BOTH = Polished(GENETIC, NloptMinimiser("sbplx", initial_step=0.05), first_share=0.6)


def bowl(population: Tensor) -> Tensor:
    return ((population - 0.3) ** 2).sum(dim=1)


def interrupt_after(batches: int, error: BaseException) -> Callable[[Tensor], Tensor]:
    calls = 0

    def objective(population: Tensor) -> Tensor:
        nonlocal calls
        calls += 1
        if calls > batches:
            raise error
        return bowl(population)

    return objective


def test_the_second_begins_where_the_first_ended_and_improves_on_it() -> None:
    first = GENETIC.minimise(bowl, 5, Budget(evaluations=180), 1)
    result = BOTH.minimise(bowl, 5, Budget(evaluations=300), 1)
    assert torch.equal(result.evaluated[:180], first.evaluated)
    assert torch.equal(result.evaluated[180], first.best)
    assert result.evaluations == 300
    assert result.best_loss < 0.5 * first.best_loss
    assert bool((result.history.diff() <= 0).all())


def test_what_the_first_leaves_goes_to_the_second() -> None:
    early = Polished(AskTellMinimiser(GeneticAlgorithm(largest_iterations=2)), NloptMinimiser("direct"))
    result = early.minimise(bowl, 5, Budget(evaluations=100), 1)
    assert (result.stop_reason, result.evaluations) == (StopReason.EVALUATIONS, 100)
    assert result.iterations == 2 + (100 - 39)


def test_time_is_shared() -> None:
    def slow(population: Tensor) -> Tensor:
        time.sleep(0.01)
        return bowl(population)

    result = BOTH.minimise(slow, 5, Budget(seconds=0.2), 1)
    assert result.stop_reason is StopReason.SECONDS
    # Populations, then single points: both had their turn.
    assert 20 < result.evaluations > result.iterations > 2
    assert not torch.equal(result.evaluated[-2:], result.evaluated[:2])


def test_a_target_reached_by_the_first_needs_no_second() -> None:
    result = BOTH.minimise(bowl, 5, Budget(evaluations=300, target=0.3), 1)
    assert result.stop_reason is StopReason.TARGET
    assert result.evaluations <= 180


@pytest.mark.parametrize(
    ("error", "reason"), [(KeyboardInterrupt(), StopReason.INTERRUPTED), (ValueError("dark"), StopReason.FAILED)]
)
@pytest.mark.parametrize("batches", [2, 10, 14])
def test_an_end_in_either_half_keeps_the_best(error: BaseException, reason: StopReason, batches: int) -> None:
    # With 180 evaluations for the first, its tenth generation is cut; the first point of the second is batch 11.
    seen = BOTH.minimise(bowl, 5, Budget(evaluations=300), 1)
    result = BOTH.minimise(interrupt_after(batches, error), 5, Budget(evaluations=300), 1)
    assert result.stop_reason is reason
    assert result.iterations == batches
    assert result.best_loss == float(seen.history[batches - 1])
    assert ("dark" in result.message) == (reason is StopReason.FAILED)


def test_a_budget_for_the_first_alone() -> None:
    result = BOTH.minimise(bowl, 5, Budget(evaluations=1), 1)
    assert (result.stop_reason, result.evaluations) == (StopReason.EVALUATIONS, 1)


def test_impossible_share_is_refused() -> None:
    for share in (0.0, 1.0, -1.0):
        with pytest.raises(ParameterError, match="first_share"):
            Polished(GENETIC, GENETIC, share)
