"""Steepest descent by differences."""

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers.ask_tell import AskTellMinimiser
from cloudfit.optimisers.base import Budget, StopReason
from cloudfit.optimisers.steepest_descent import DescentState, SteepestDescent
from render.errors import ParameterError


def bowl(population: Tensor) -> Tensor:
    return ((population - 0.3) ** 2).sum(dim=1)


def slope_at(point: list[float], method: SteepestDescent) -> Tensor:
    state = DescentState(torch.tensor(point, dtype=torch.float64), float("inf"))
    population, state = method.ask(state)
    state = method.tell(state, population, (population * torch.tensor([2.0, -3.0])).sum(dim=1))
    assert state.slope is not None
    return state.slope


def test_the_slope_of_a_plane_is_exact_within_and_at_bounds() -> None:
    for point in ([0.4, 0.7], [0.0, 1.0], [0.003, 0.5]):
        torch.testing.assert_close(slope_at(point, SteepestDescent()), torch.tensor([2.0, -3.0]).double())


def test_the_longest_step_that_is_good_enough_is_taken() -> None:
    method = SteepestDescent(longest_step=0.8, halvings=3)
    start = DescentState(torch.tensor([0.9], dtype=torch.float64), 0.36, torch.tensor([1.2], dtype=torch.float64))
    line, _ = method.ask(start)
    assert line[:, 0].tolist() == pytest.approx([0.1, 0.5, 0.7, 0.8])
    # Armijo's rule accepts 0.1 (loss 0.04); a worse first trial is passed over.
    assert float(method.tell(start, line, bowl(line)).point[0]) == pytest.approx(0.1)
    worse = bowl(line)
    worse[0] = 0.5
    assert float(method.tell(start, line, worse).point[0]) == pytest.approx(0.5)
    # 1e-4 of what the gradient promises is not reached by a loss that stays the same.
    assert method.tell(start, line, torch.full((4,), 0.36)).converged


def test_each_slope_and_each_line_is_one_batch() -> None:
    result = AskTellMinimiser(SteepestDescent()).minimise(bowl, 5, Budget(evaluations=11 + 12 + 11), 1)
    assert (result.iterations, result.evaluations) == (3, 34)


def test_it_ends_in_the_valley_where_it_starts() -> None:
    def valleys(population: Tensor) -> Tensor:
        return torch.minimum(bowl(population) + 0.05, 4.0 * ((population - 0.8) ** 2).sum(dim=1))

    method = AskTellMinimiser(SteepestDescent())
    near = method.minimise(valleys, 3, Budget(), 1, start=torch.full((3,), 0.2))
    far = method.minimise(valleys, 3, Budget(), 1, start=torch.full((3,), 0.9))
    assert near.stop_reason is StopReason.CONVERGED
    assert near.best_loss == pytest.approx(0.05, abs=1e-4)
    assert far.best_loss < 1e-3


def test_it_follows_bounds() -> None:
    def slide(population: Tensor) -> Tensor:
        return population[:, 0] + (population[:, 1] - 0.4) ** 2

    result = AskTellMinimiser(SteepestDescent()).minimise(slide, 2, Budget(), 1, start=torch.tensor([0.3, 0.9]))
    torch.testing.assert_close(result.best, torch.tensor([0.0, 0.4]), rtol=0, atol=1e-2)


def test_iterations_are_limited() -> None:
    method = AskTellMinimiser(SteepestDescent(largest_iterations=2))
    result = method.minimise(lambda p: -p.exp().sum(dim=1) * 1e-3 + bowl(p * torch.tensor([1.0, 9.0])), 2, Budget(), 3)
    assert (result.stop_reason, result.iterations) == (StopReason.ITERATIONS, 4)


def test_impossible_numbers_are_refused() -> None:
    for keywords in ({"difference": 0.0}, {"longest_step": 2.0}, {"halvings": -1}, {"largest_iterations": 0}):
        with pytest.raises(ParameterError, match="expected"):
            SteepestDescent(**keywords)  # type: ignore[arg-type]
