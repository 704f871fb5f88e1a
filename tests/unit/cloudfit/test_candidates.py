"""The ranked list of distinct answers."""

import pytest
import torch

from cloudfit.candidates import distinct_candidates
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
