import pytest
import torch

from cloudfit.losses.squared_difference import squared_difference


def test_two_pixels_by_hand() -> None:
    values = torch.tensor([[0.5, 0.25], [1.0, 0.0]])
    target = torch.tensor([[0.25, 0.25], [0.0, 1.0]])
    assert squared_difference(values, target).tolist() == [0.03125, 1.0]
    # The same colours in the other place: a histogram would see no difference.
    assert squared_difference(target.flip(-1), target).tolist() == pytest.approx([0.0, 1.0])


def test_a_population_is_compared_at_once() -> None:
    population = torch.rand(4, 3, 50, generator=torch.Generator().manual_seed(0))
    assert squared_difference(population, population[2])[2].tolist() == [0.0] * 3
    assert squared_difference(population, population[2]).shape == (4, 3)
