"""What nearly equal answers have in common."""

import pytest
import torch
from torch import Tensor

from cloudfit.determination import DETERMINED_SHARE, WALK_STEPS, measure_determination, walk_through
from cloudfit.parameters import Parameter, SearchSpace
from render.errors import ParameterError

SPACE = SearchSpace(
    (Parameter("albedo", "beta", "1", 0.0, 2.0), Parameter("extinction", "sigma_t", "1/m", 0.01, 1.0, "log"))
)


def first_alone(points: Tensor) -> Tensor:
    """A loss that the second parameter does not enter."""
    return 0.5 + (points[:, 0] - 0.37).abs()


def product(points: Tensor) -> Tensor:
    """A loss that only the product of both enters: a walk through one parameter alone sees nothing of the valley."""
    return 0.5 + 20.0 * (points.prod(1) - 0.25).abs()


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
    # 0.4 is on the walk and 0.03 from the best, within a tenth of 0.5.
    assert albedo.highest == pytest.approx(0.8)
    assert found.excess <= 0.05
    # Two of the search, the walk through the second, and one step of the walk through the first.
    assert found.answers == 2 + WALK_STEPS + 1 + 1


def test_a_valley_is_known_from_the_search() -> None:
    along = torch.linspace(0.3, 0.8, 50)
    valley = torch.stack([along, 0.25 / along], dim=1)
    found = measure_determination(product, SPACE, valley, product(valley), 0.0)
    assert [spread.is_determined for spread in found.parameters] == [False, False]
    one = measure_determination(product, SPACE, valley[20:21], product(valley[20:21]), 0.0)
    assert [spread.is_determined for spread in one.parameters] == [True, True]


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
