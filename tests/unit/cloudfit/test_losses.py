"""Histogram losses against closed forms, and the L1 floor against Monte Carlo."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from cloudfit.losses import LOSSES, flat_l1_floor, l1_floor
from render.errors import ParameterError

BINS = 256


def random_histograms(*leading: int, seed: int = 0) -> Tensor:
    values = torch.rand(*leading, BINS, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) ** 4
    return values / values.sum(dim=-1, keepdim=True)


def single_level(level: int) -> Tensor:
    return torch.nn.functional.one_hot(torch.tensor(level), BINS).double()


@pytest.mark.parametrize("name", LOSSES)
def test_contract(name: str) -> None:
    loss = LOSSES[name]
    first, second = random_histograms(5, 3, seed=1), random_histograms(5, 3, seed=2)
    values = loss(first, second)
    assert loss.name == name
    assert values.dtype == torch.float64
    assert values.shape == (5, 3)
    # The optimum is reached at equality, also of spiky and of empty histograms, and only there.
    for histogram in (first, single_level(0), single_level(255), torch.zeros(BINS)):
        assert bool((loss(histogram, histogram) == loss.optimum).all())
    assert bool((values > loss.optimum).all())
    assert bool((values < loss.worst).all())
    assert float(loss(single_level(0), single_level(255))) == loss.worst
    torch.testing.assert_close(loss(second, first), values)
    torch.testing.assert_close(loss(first, second[0]), torch.stack([loss(row, second[0]) for row in first]))
    assert bool(loss(torch.full((BINS,), math.nan), second[0, 0]).isnan())


@pytest.mark.parametrize("name", LOSSES)
def test_shape_errors_show_both_shapes(name: str) -> None:
    for shape in ((3, 255), (2, BINS), (1,), ()):
        with pytest.raises(ParameterError, match=r"\(3, 256\)"):
            LOSSES[name](torch.zeros(3, BINS), torch.zeros(shape))


def test_l1_is_twice_the_moved_share_and_blind_to_distance() -> None:
    mixed = 0.75 * single_level(10) + 0.25 * single_level(200)
    assert float(LOSSES["l1"](mixed, single_level(10))) == pytest.approx(0.5)
    assert float(LOSSES["l1"](single_level(10), single_level(11))) == 2.0


def test_wasserstein_is_the_mean_distance_in_levels() -> None:
    wasserstein = LOSSES["wasserstein"]
    assert float(wasserstein(single_level(10), single_level(13))) == pytest.approx(3.0)
    mixed = 0.75 * single_level(10) + 0.25 * single_level(200)
    assert float(wasserstein(mixed, single_level(10))) == pytest.approx(0.25 * 190)
    # Sorted samples: the one-dimensional distance is the mean difference of the order statistics.
    rng = np.random.default_rng(4)
    first, second = rng.integers(0, 200, 5000), rng.integers(30, 256, 5000)
    histograms = [torch.from_numpy(np.bincount(levels, minlength=BINS) / 5000) for levels in (first, second)]
    expected = np.abs(np.sort(first) - np.sort(second)).mean()
    assert float(wasserstein(*histograms)) == pytest.approx(expected, abs=1e-9)
    assert abs(float(LOSSES["l1"](*histograms)) - expected) > 1


def test_registry_is_frozen() -> None:
    with pytest.raises(TypeError):
        LOSSES["l2"] = LOSSES["l1"]  # type: ignore[index]


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
