"""The ranked list of distinct answers."""

import pytest
import torch
from torch import Tensor

from cloudfit.candidates import VISIBLE_LEVELS, distinct_candidates, nearly_best
from render.errors import ParameterError


def test_best_first_neighbours_and_bad_ones_left_out() -> None:
    evaluated = torch.tensor([[0.5, 0.5], [0.9, 0.5], [0.54, 0.45], [0.1, 0.1], [0.88, 0.52], [0.0, 1.0]])
    losses = torch.tensor([0.40, 0.42, 0.41, 0.43, 0.39, 0.90])
    assert distinct_candidates(evaluated, losses, 10, 0.1, 0.2).tolist() == [4, 0, 3]
    # Each rule on its own: closer neighbours, fewer, a sharper cut, an absolute one.
    assert distinct_candidates(evaluated, losses, 10, 0.01, 0.2).tolist() == [4, 0, 2, 1, 3]
    assert distinct_candidates(evaluated, losses, 2, 0.1, 0.2).tolist() == [4, 0]
    assert distinct_candidates(evaluated, losses, 10, 0.1, 0.05).tolist() == [4, 0]
    assert distinct_candidates(evaluated, losses, 10, 0.1, 0.05, 1.0).tolist() == [4, 0, 3, 5]


def test_separation_is_the_largest_difference_of_any_parameter() -> None:
    evaluated = torch.tensor([[0.5, 0.5, 0.5], [0.59, 0.59, 0.59], [0.5, 0.5, 0.625]])
    losses = torch.tensor([1.0, 1.01, 1.02])
    # The second is farther in the Euclidean norm (0.156) than the third (0.125), yet it is the neighbour.
    assert distinct_candidates(evaluated, losses, 3, 0.125).tolist() == [0, 2]


def test_equal_losses_keep_the_order_of_evaluation_and_copies_count_once() -> None:
    evaluated = torch.tensor([[0.2], [0.8], [0.8], [0.2]])
    assert distinct_candidates(evaluated, torch.ones(4), 4, 0.1).tolist() == [0, 1]
    assert distinct_candidates(evaluated, torch.ones(4), 9, 0.0).tolist() == [0, 1, 2, 3]


def test_negative_and_zero_losses() -> None:
    evaluated = torch.tensor([[0.1], [0.5], [0.9]])
    assert distinct_candidates(evaluated, torch.tensor([-1.0, -0.95, -0.8]), 3).tolist() == [0, 1]
    assert distinct_candidates(evaluated, torch.tensor([0.0, 0.01, 0.2]), 3, absolute_excess=0.05).tolist() == [0, 1]


def test_not_finite_losses_are_never_listed() -> None:
    evaluated = torch.tensor([[0.1], [0.5], [0.9]])
    losses = torch.tensor([float("nan"), 0.5, float("-inf")])
    assert distinct_candidates(evaluated, losses, 3).tolist() == [1]
    with pytest.raises(ParameterError, match="finite"):
        distinct_candidates(evaluated, torch.full((3,), float("nan")), 3)


def test_properties_on_many_evaluations() -> None:
    generator = torch.Generator().manual_seed(1)
    evaluated = torch.rand(100_000, 5, generator=generator)
    losses = 0.3 + (evaluated - 0.5).abs().amax(dim=1) * 0.1
    chosen = distinct_candidates(evaluated, losses, 20, 0.2)
    assert chosen[0] == losses.argmin()
    assert 2 <= len(chosen) <= 20
    assert bool((losses[chosen].diff() >= 0).all())
    assert bool((losses[chosen] <= 1.1 * losses.min()).all())
    distances = (evaluated[chosen][:, None] - evaluated[chosen]).abs().amax(dim=-1) + torch.eye(len(chosen))
    assert float(distances.min()) >= 0.2


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(ParameterError, match=r"\(4, 2\) and \(3,\)"):
        distinct_candidates(torch.zeros(4, 2), torch.zeros(3), 1)
    for keywords in ({"count": 0}, {"count": 1, "separation": -1.0}, {"count": 1, "relative_excess": -1.0}):
        with pytest.raises(ParameterError, match="expected count"):
            distinct_candidates(torch.zeros(4, 2), torch.zeros(4), **keywords)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="0 evaluations"):
        distinct_candidates(torch.zeros(0, 2), torch.zeros(0), 1)


def sunlit(points: Tensor) -> Tensor:
    """A grey picture: sun times albedo, and ambient light; levels of two pixels of which one sees less sun."""
    sun, albedo, ambient = points.T
    return 255.0 * torch.stack([sun * albedo + ambient, 0.5 * sun * albedo + ambient], dim=1)


def test_parameters_that_do_nothing_make_no_difference() -> None:
    black_dim, black_bright, white_bright = [0.2, 0.0, 0.5], [0.9, 0.0, 0.5], [0.9, 0.4, 0.1]
    evaluated = torch.tensor([black_dim, black_bright, white_bright])
    losses = torch.tensor([1.0, 1.001, 1.002])
    assert distinct_candidates(evaluated, losses, 3).tolist() == [0, 1, 2]
    assert distinct_candidates(evaluated, losses, 3, appearance=sunlit).tolist() == [0, 2]
    # Different parameters that do something count, even though the pictures are the same.
    trade = torch.tensor([[0.8, 0.3, 0.2], [0.3, 0.8, 0.2]])
    assert torch.allclose(sunlit(trade[:1]), sunlit(trade[1:]), atol=1e-3)
    assert distinct_candidates(trade, losses[:2], 3, appearance=sunlit).tolist() == [0, 1]


def test_a_parameter_that_is_seen_in_one_of_both_answers_counts() -> None:
    # The sun cannot be seen in the first, which is black, but taking over the first's sun darkens the second.
    evaluated = torch.tensor([[0.2, 0.0, 0.5], [0.9, 0.09, 0.5]])
    assert distinct_candidates(evaluated, torch.ones(2), 2, appearance=sunlit).tolist() == [0, 1]


def test_changes_below_a_level_are_not_seen() -> None:
    evaluated = torch.tensor([[0.2], [0.8]])
    for levels, expected in ((0.5 * VISIBLE_LEVELS, [0]), (2.0 * VISIBLE_LEVELS, [0, 1])):
        found = distinct_candidates(
            evaluated, torch.ones(2), 2, appearance=lambda points, levels=levels: points * levels / 0.6
        )
        assert found.tolist() == expected


def test_nearly_best_answers() -> None:
    losses = torch.tensor([0.5, torch.nan, 0.54, 0.56, 0.7, torch.inf])
    assert nearly_best(losses).tolist() == [True, False, True, False, False, False]
    assert nearly_best(losses, absolute_excess=0.1).tolist() == [True, False, True, True, False, False]
    assert int(nearly_best(losses, 0.0).sum()) == 1
