"""The floor of the L1 loss against Monte Carlo, and the sampled floor against the closed one."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from cloudfit.losses.floor import DRAWS, flat_l1_floor, l1_floor, sampled_floor
from cloudfit.losses.histogram import l1_distance
from render.errors import ParameterError
from tests.unit.cloudfit.test_losses import BINS, random_histograms, single_level

FLAT = torch.full((BINS,), 1.0 / BINS, dtype=torch.float64)
NARROW = torch.exp(-0.5 * ((torch.arange(BINS) - 200) / 3.0) ** 2).double()
TWO_LEVELS = 0.5 * (single_level(0) + single_level(255))


@pytest.mark.parametrize(
    ("histogram", "pixels"),
    [(FLAT, 4000), (FLAT, 100), (NARROW / NARROW.sum(), 3000), (TWO_LEVELS, 1000), (random_histograms(seed=3), 500)],
    ids=["flat", "flat and sparse", "narrow", "two levels", "random"],
)
def test_floor_is_the_mean_of_two_independent_samples(histogram: Tensor, pixels: int) -> None:
    trials = 4000
    rng = np.random.default_rng(5)
    counts = rng.multinomial(pixels, histogram.numpy() / float(histogram.sum()), size=(2, trials))
    distances = np.abs(counts[0] - counts[1]).sum(axis=1) / pixels
    error = distances.std(ddof=1) / math.sqrt(trials)
    z = (distances.mean() - float(l1_floor(histogram, pixels))) / error
    # Five tests at 4 standard errors: less than one false alarm in 3000 runs of the suite.
    assert abs(z) < 4
    # A floor that forgot one of its two samples, a factor sqrt 2, or was a tenth off would be seen.
    for wrong in (1 / math.sqrt(2), 0.9, 1.1):
        assert abs(distances.mean() - wrong * float(l1_floor(histogram, pixels))) / error > 4


def test_floor_limits() -> None:
    assert float(l1_floor(FLAT, 40_000)) == pytest.approx(flat_l1_floor(40_000), rel=5e-3)
    assert flat_l1_floor(40_000) == pytest.approx(18 / math.sqrt(40_000), rel=5e-3)
    assert float(l1_floor(single_level(7), 100)) == 0.0
    # One pixel of a flat histogram almost surely meets another level: the floor approaches the worst loss, never beyond.
    assert 1.9 < float(l1_floor(FLAT, 1)) < 2.0
    assert flat_l1_floor(1) > 2.0


def test_floor_is_lower_for_narrow_histograms_and_batched() -> None:
    stacked = l1_floor(torch.stack([FLAT, NARROW / NARROW.sum()]), 10_000)
    assert stacked.shape == (2,)
    assert float(stacked[1]) < 0.5 * float(stacked[0])
    with pytest.raises(ParameterError, match="at least one"):
        l1_floor(FLAT, 0)


def level_histograms(values: Tensor) -> Tensor:
    return torch.stack([torch.bincount(row.long(), minlength=BINS) / len(row) for row in values])


def test_the_sampled_floor_is_the_closed_one() -> None:
    values = torch.randint(0, BINS, (3, 5000), generator=torch.Generator().manual_seed(6)).float()
    values[1] = 0.1 * values[1] + 100.0

    def l1_of_values(first: Tensor, second: Tensor) -> Tensor:
        return l1_distance(level_histograms(first), level_histograms(second))

    closed = l1_floor(level_histograms(values), 2000)
    sampled = sampled_floor(l1_of_values, values, 2000)
    assert sampled.shape == (3,)
    # The standard deviation of one draw is at most a tenth of the floor here: three standard errors.
    torch.testing.assert_close(sampled, closed, rtol=3 * 0.1 / math.sqrt(DRAWS), atol=0.0)
    assert torch.equal(sampled, sampled_floor(l1_of_values, values, 2000))
    assert not torch.equal(sampled, sampled_floor(l1_of_values, values, 2000, seed=1))
    halved = sampled_floor(l1_of_values, values, 8000)
    assert float(halved[0] / sampled[0]) == pytest.approx(0.5, abs=0.1)


def test_a_sampled_floor_needs_pixels() -> None:
    for values, count in ((torch.zeros(3, 0), 5), (torch.zeros(3, 5), 0)):
        with pytest.raises(ParameterError, match="at least one pixel"):
            sampled_floor(l1_distance, values, count)
