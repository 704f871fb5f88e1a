"""Designs."""

import torch

from cloudfit.optimisers.space_filling import space_filling_points


def test_points_are_more_even_than_chance() -> None:
    points = space_filling_points(64, 3, seed=5)
    assert points.shape == (64, 3)
    # Of 64 = 2^6 points of a Sobol sequence, each 64th of each axis holds exactly one; random points leave a third empty.
    for column in (points * 64).long().T:
        assert len(column.unique()) == 64
    random = torch.rand(64, generator=torch.Generator().manual_seed(5))
    assert len((random * 64).long().unique()) < 50


def test_the_seed_scrambles_and_the_start_comes_first() -> None:
    assert torch.equal(space_filling_points(8, 2, 1), space_filling_points(8, 2, 1))
    assert not torch.equal(space_filling_points(8, 2, 1), space_filling_points(8, 2, 2))
    start = torch.tensor([0.25, 0.75])
    begun = space_filling_points(8, 2, 1, start)
    assert begun.shape == (8, 2)
    assert begun[0].tolist() == [0.25, 0.75]
    assert torch.equal(begun[1:], space_filling_points(7, 2, 1))
