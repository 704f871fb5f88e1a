"""The model of the loss: what it reproduces, what it smooths and what it flattens."""

import math

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers.base import PENALTY
from cloudfit.optimisers.cubic_surrogate import CubicSurrogate, distances, fit_surrogate
from cloudfit.optimisers.space_filling import space_filling_points

POINTS = space_filling_points(80, 3, 1)


def bowl(points: Tensor) -> Tensor:
    return ((points - 0.3) ** 2).sum(dim=1)


def flattened(losses: Tensor) -> Tensor:
    """What the model is asked to reproduce."""
    low = losses.clamp(max=losses.median())
    return (low - low.mean()) / low.std(correction=0)


def test_formula_by_hand() -> None:
    model = CubicSurrogate(torch.tensor([[0.0], [1.0]]), torch.tensor([2.0, -1.0]), torch.tensor([0.5, 3.0]))
    # 2 |x|^3 - |x - 1|^3 + 0.5 + 3 x at x = 0.5 and 3
    assert model(torch.tensor([[0.5], [3.0]])).tolist() == pytest.approx([0.25 - 0.125 + 2.0, 54.0 - 8.0 + 9.5])


def test_it_predicts_between_the_points_where_chance_does_not() -> None:
    losses = bowl(POINTS)
    model = fit_surrogate(POINTS, losses)
    elsewhere = space_filling_points(400, 3, 2)
    truth = bowl(elsewhere)
    near = truth < losses.median()
    expected = (truth - losses.clamp(max=losses.median()).mean()) / losses.clamp(max=losses.median()).std(correction=0)
    error = (model(elsewhere) - expected)[near].square().mean().sqrt()
    assert float(error) < 0.3 * float(expected[near].std())
    shuffled = fit_surrogate(POINTS, losses.flip(0))
    assert float((shuffled(elsewhere) - expected)[near].square().mean().sqrt()) > float(expected[near].std())


def test_the_orthogonality_of_the_weights_makes_a_plane_exact() -> None:
    # Half of a plane lies above its median and would be flattened, so that the upper half is repeated at the top.
    plane = 2.0 * POINTS[:, 0] - POINTS[:, 1]
    many = torch.cat([POINTS, POINTS[plane.argmax()].expand(81, 3)])
    losses = torch.cat([plane, plane.max().expand(81)])
    model = fit_surrogate(many, losses)
    expected = (plane - losses.mean()) / losses.std(correction=0)
    torch.testing.assert_close(model(POINTS), expected, rtol=0, atol=1e-6)


def test_small_steps_are_smoothed_out() -> None:
    losses = bowl(POINTS)
    steps = 0.02 * torch.rand(80, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    smooth, rough = fit_surrogate(POINTS, losses), fit_surrogate(POINTS, losses + steps)
    residual = (rough(POINTS) - flattened(losses + steps)).std()
    assert float(residual) > 10.0 * float((smooth(POINTS) - flattened(losses)).std()) * 0.1
    assert 1e-3 < float(residual) < 0.2


@pytest.mark.parametrize("bad", [PENALTY])
def test_penalties_do_not_bend_it(bad: float) -> None:
    losses = bowl(POINTS)
    high = losses > losses.quantile(0.8)
    punished = torch.where(high, bad, losses)
    model = fit_surrogate(POINTS, punished)
    low = ~high
    order = model(POINTS[low]).argsort()[:10]
    assert float(bowl(POINTS[low])[order].max()) < float(losses.quantile(0.3))


@pytest.mark.parametrize(
    ("points", "losses"),
    [
        (torch.full((30, 2), 0.4), torch.arange(30.0)),
        (torch.rand(30, 2, generator=torch.Generator().manual_seed(1)), torch.ones(30)),
        (torch.rand(30, 2, generator=torch.Generator().manual_seed(1)), torch.full((30,), PENALTY)),
        (torch.rand(3, 8, generator=torch.Generator().manual_seed(1)), torch.arange(3.0)),
        (torch.tensor([[0.5]]), torch.tensor([1.0])),
    ],
)
def test_hopeless_data_give_finite_numbers(points: Tensor, losses: Tensor) -> None:
    predicted = fit_surrogate(points.double(), losses.double())(torch.rand(9, points.shape[1]).double())
    assert bool(predicted.isfinite().all())


def test_distances_of_close_points_are_exact() -> None:
    near = torch.tensor([[0.5, 0.5], [0.5 + 3e-9, 0.5 + 4e-9]], dtype=torch.float64)
    assert float(distances(near, near)[0, 1]) == pytest.approx(5e-9, rel=1e-6)
    assert math.isclose(float(distances(near, near)[0, 0]), 0.0)
