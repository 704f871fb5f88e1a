"""What the gradient methods share."""

from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers.base import Budget, StopReason
from cloudfit.optimisers.gradient_descent import GradientMinimiser
from cloudfit.optimisers.space_filling import space_filling_points
from render.errors import ParameterError


class Plane:
    def __call__(self, population: Tensor) -> Tensor:
        return 2.0 * population[:, 0] - population[:, 1]

    def with_gradient(self, population: Tensor) -> tuple[Tensor, Tensor]:
        return self(population), torch.tensor([2.0, -1.0]).expand_as(population)


@dataclass(frozen=True)
class OneStep:
    """Goes a tenth against the gradient, twice."""

    def init(self, starts: Tensor) -> tuple[Tensor, int]:
        return starts, 0

    def ask(self, state: tuple[Tensor, int]) -> Tensor:
        return state[0]

    def tell(self, state: tuple[Tensor, int], losses: Tensor, gradient: Tensor) -> tuple[Tensor, int]:
        return (state[0] - 0.1 * gradient).clamp(0.0, 1.0), state[1] + 1

    def stop_reason(self, state: tuple[Tensor, int]) -> StopReason | None:
        return StopReason.CONVERGED if state[1] == 2 else None


def test_all_starts_of_the_design_step_together() -> None:
    result = GradientMinimiser(OneStep(), starts=4).minimise(Plane(), 2, Budget(), 7)
    starts = space_filling_points(4, 2, 7).float()
    assert (result.iterations, result.evaluations) == (2, 8)
    assert torch.equal(result.evaluated[:4], starts)
    torch.testing.assert_close(result.evaluated[4:], (starts - torch.tensor([0.2, -0.1])).clamp(0.0, 1.0))


def test_a_given_start_is_among_them() -> None:
    start = torch.tensor([0.5, 0.25])
    result = GradientMinimiser(OneStep(), starts=1).minimise(Plane(), 2, Budget(), 7, start=start)
    assert torch.equal(result.evaluated[0], start)


def test_losses_without_gradient_and_no_starts_are_refused() -> None:
    with pytest.raises(ParameterError, match="choose a differentiable loss"):
        GradientMinimiser(OneStep()).minimise(lambda population: population[:, 0], 2, Budget(), 1)
    with pytest.raises(ParameterError, match="at least one start"):
        GradientMinimiser(OneStep(), starts=0)
