"""What nearly equal answers have in common."""

import pytest
import torch
from torch import Tensor

from cloudfit.determination import (
    CHAINS,
    DETERMINED_SHARE,
    GENERATIONS,
    WALK_STEPS,
    explore,
    measure_determination,
    walk_through,
)
from cloudfit.parameters import Parameter, SearchSpace
from render.errors import ParameterError

SPACE = SearchSpace(
    (Parameter("albedo", "beta", "1", 0.0, 2.0), Parameter("extinction", "sigma_t", "1/m", 0.01, 1.0, "log"))
)


def first_alone(points: Tensor) -> Tensor:
    """A loss that the second parameter does not enter."""
    return 0.5 + (points[:, 0] - 0.37).abs()


def test_a_walk_changes_one_parameter_at_a_time_over_its_whole_range() -> None:
    best = torch.tensor([0.3, 0.8, 0.5])
    walked = walk_through(best)
    assert walked.shape == (3 * (WALK_STEPS + 1), 3)
    assert bool(((walked != best).sum(1) <= 1).all())
    assert walked.amin(0).tolist() == [0.0] * 3
    assert walked.amax(0).tolist() == [1.0] * 3


def test_a_parameter_without_effect_is_open_though_the_search_never_moved_it() -> None:
    evaluated = torch.tensor([[0.37, 0.5], [0.38, 0.5], [0.9, 0.5]])
    found = measure_determination(first_alone, SPACE, evaluated, first_alone(evaluated), 0.0)
    albedo, extinction = found.parameters
    assert (albedo.name, albedo.is_determined) == ("albedo", True)
    assert (extinction.name, extinction.is_determined) == ("extinction", False)
    assert (extinction.lowest, extinction.highest) == pytest.approx((0.01, 1.0))
    assert extinction.share == 1.0
    # Nearly equal is what lies within a tenth of 0.5: a twentieth of the range to either side of 0.37.
    assert 0.05 < albedo.share <= 0.1
    assert 2.0 * 0.32 <= albedo.lowest < albedo.highest <= 2.0 * 0.42
    assert found.excess <= 0.05
    # Two of the search, the walk through the second, one step of the walk through the first, and what was explored.
    assert found.answers > 2 + WALK_STEPS + 1 + 1


def slab(points: Tensor) -> Tensor:
    """A loss that only the sum of all parameters enters, to 0.0025: the parameters make up for each other."""
    return 0.5 + 20.0 * (points.sum(1) - 0.4 * points.shape[1]).abs()


def bowl(points: Tensor) -> Tensor:
    """A loss that determines every parameter: nearly equal answers fill a ball of radius 0.05."""
    return 0.5 + 20.0 * (points - 0.4).square().sum(1)


FIVE = SearchSpace(tuple(Parameter(name, name, "1", 0.0, 1.0) for name in "abcde"))


@pytest.mark.parametrize("seed", range(3))
def test_valleys_are_followed_from_where_the_search_has_ended(seed: int) -> None:
    evaluated = 0.4 + 0.02 * torch.randn(300, 5, generator=torch.Generator().manual_seed(seed))
    # No walk through one parameter alone sees the valley.
    assert int((slab(walk_through(evaluated[slab(evaluated).argmin()])) < 0.55).sum()) <= 5
    along = measure_determination(slab, FIVE, evaluated, slab(evaluated), 0.0, seed)
    assert not any(spread.is_determined for spread in along.parameters)
    within = measure_determination(bowl, FIVE, evaluated, bowl(evaluated), 0.0, seed)
    assert all(spread.is_determined for spread in within.parameters)
    assert all(0.05 < spread.share <= 0.1 + 1e-6 for spread in within.parameters)


def test_exploring_is_reproducible_and_stays_in_the_cube() -> None:
    start = torch.full((1, 5), 0.4)
    points, losses = explore(slab, start, slab(start), 0.0, 3)
    again, other = (explore(slab, start, slab(start), 0.0, seed)[0] for seed in (3, 4))
    assert len(points) == len(losses) == 1 + CHAINS * GENERATIONS
    assert torch.equal(losses, slab(points))
    assert bool(((points >= 0.0) & (points <= 1.0)).all())
    assert torch.equal(points, again)
    assert not torch.equal(points, other)


def test_what_counts_as_nearly_equal_follows_the_floor() -> None:
    evaluated = torch.tensor([[0.37, 0.5]])
    shares = [
        measure_determination(first_alone, SPACE, evaluated, first_alone(evaluated), floor).parameters[0].share
        for floor in (0.0, 0.2, 0.4)
    ]
    assert shares == sorted(shares)
    assert shares[0] <= DETERMINED_SHARE < shares[2]


def test_wrong_shapes_and_lost_searches_are_refused() -> None:
    with pytest.raises(ParameterError, match=r"\(2, 2\), got \(2, 3\)"):
        measure_determination(first_alone, SPACE, torch.zeros(2, 3), torch.zeros(2), 0.0)
    with pytest.raises(ParameterError, match="finite"):
        measure_determination(
            lambda points: torch.full((len(points),), torch.nan),
            SPACE,
            torch.zeros(2, 2),
            torch.full((2,), torch.nan),
            0.0,
        )
