"""Adam against torch's own, and at bounds."""

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers.adam import Adam
from cloudfit.optimisers.base import StopReason
from render.errors import ParameterError


def rosenbrock(points: Tensor) -> Tensor:
    """Valley along a parabola with its minimum at (0.5, 0.25)."""
    return (points[:, 0] - 0.5) ** 2 + 10.0 * (points[:, 1] - points[:, 0] ** 2) ** 2


def slope(points: Tensor) -> Tensor:
    points = points.detach().requires_grad_()
    return torch.autograd.grad(rosenbrock(points).sum(), points)[0]


STARTS = torch.tensor([[0.2, 0.7], [0.9, 0.4], [0.5, 0.9]], dtype=torch.float64)


def run(method: Adam, starts: Tensor, steps: int) -> Tensor:
    state = method.init(starts)
    for _ in range(steps):
        assert method.stop_reason(state) is None
        points = method.ask(state)
        state = method.tell(state, rosenbrock(points), slope(points))
    return state.points


@pytest.mark.parametrize("shift", [0, 1])
def test_steps_are_those_of_torch(shift: int) -> None:
    method = Adam(step=0.02, largest_iterations=40)
    points = STARTS.clone().requires_grad_()
    reference = torch.optim.Adam([points], lr=0.02, betas=(0.9, 0.99 if shift == 0 else 0.9))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(reference, 40)
    for _ in range(25):
        points.grad = slope(points)
        reference.step()
        schedule.step()
    same = torch.allclose(run(method, STARTS, 25), points.detach(), rtol=0, atol=1e-12)
    assert same == (shift == 0)


def test_the_minimum_is_found_from_every_start() -> None:
    method = Adam(largest_iterations=300)
    torch.testing.assert_close(
        run(method, STARTS, 300), torch.tensor([0.5, 0.25]).double().expand(3, 2), rtol=0, atol=0.02
    )


def test_points_stay_in_the_cube() -> None:
    method = Adam(step=0.5)
    state = method.init(STARTS)
    for _ in range(5):
        state = method.tell(state, torch.zeros(3), torch.tensor([1.0, -1.0]).double().expand(3, 2))
    assert state.points.tolist() == [[0.0, 1.0]] * 3


def test_the_last_step_ends_it() -> None:
    method = Adam(largest_iterations=2)
    state = method.init(STARTS)
    for _ in range(2):
        state = method.tell(state, torch.zeros(3), slope(state.points))
    assert method.stop_reason(state) is StopReason.ITERATIONS


def test_impossible_numbers_are_refused() -> None:
    for keywords in ({"step": 0.0}, {"mean_decay": 1.0}, {"square_decay": -0.1}, {"largest_iterations": 0}):
        with pytest.raises(ParameterError, match="expected a step"):
            Adam(**keywords)  # type: ignore[arg-type]
