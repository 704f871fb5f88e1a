"""Histogram losses against closed forms, hand-computed cases and OpenCV."""

import cv2
import numpy as np
import pytest
import torch

from cloudfit.losses import LOSSES
from cloudfit.losses.histogram import HISTOGRAM_LOSSES
from tests.unit.cloudfit.test_losses import BINS, random_histograms, single_level

BY_HAND = {
    # Of (1/2, 1/2, 0) before the photograph's (1/4, 1/2, 1/4).
    "l1": 0.5,
    # Deviations from the mean 1/3: (1, 1, -2) / 6 and (-1, 2, -1) / 12; r = (3 / 72) / sqrt((6 / 36) (6 / 144)) = 1 / 2.
    "correlation": 0.5,
    "chi_square": 0.25 + 0.25,
    "chi_square_symmetric": 2.0 * (0.0625 / 0.75 + 0.0625 / 0.25),
    "intersection": 0.25,
    "bhattacharyya": (1.0 - 0.125**0.5 - 0.5) ** 0.5,
    "wasserstein": 0.25 + 0.25,
}


@pytest.mark.parametrize("name", BY_HAND)
def test_three_bins_by_hand(name: str) -> None:
    rendering, photograph = torch.tensor([0.5, 0.5, 0.0]), torch.tensor([0.25, 0.5, 0.25])
    assert float(LOSSES[name](rendering, photograph)) == pytest.approx(BY_HAND[name], rel=1e-12)


def test_every_histogram_loss_is_computed_by_hand() -> None:
    assert {loss.name for loss in HISTOGRAM_LOSSES} == set(BY_HAND)


OPENCV = {
    "correlation": (cv2.HISTCMP_CORREL, lambda value: 1.0 - value),
    "chi_square": (cv2.HISTCMP_CHISQR, lambda value: value),
    "chi_square_symmetric": (cv2.HISTCMP_CHISQR_ALT, lambda value: value),
    "intersection": (cv2.HISTCMP_INTERSECT, lambda value: 1.0 - value),
    "bhattacharyya": (cv2.HISTCMP_BHATTACHARYYA, lambda value: value),
}


@pytest.mark.parametrize("name", OPENCV)
@pytest.mark.parametrize("sparse", [False, True])
def test_opencv_agrees(name: str, sparse: bool) -> None:
    method, as_loss = OPENCV[name]
    for seed in range(5):
        # No tiny bins: OpenCV divides in float32.
        histograms = 0.9 * random_histograms(2, seed=seed) + 0.1 / BINS
        if sparse:
            histograms[0, ::3], histograms[1, 1::4] = 0.0, 0.0
            histograms /= histograms.sum(-1, keepdim=True)
        rendering, photograph = histograms.float()
        expected = as_loss(cv2.compareHist(photograph.numpy(), rendering.numpy(), method))
        assert float(LOSSES[name](rendering, photograph)) == pytest.approx(expected, rel=1e-5, abs=1e-6)
        swapped = as_loss(cv2.compareHist(rendering.numpy(), photograph.numpy(), method))
        assert (swapped == pytest.approx(expected, rel=1e-5)) is (name != "chi_square")


@pytest.mark.parametrize("count", [1.0, 1e3, 6.3e5])
def test_a_flat_histogram_equals_itself_whatever_opencv_says(count: float) -> None:
    # Counts of a flat histogram: OpenCV 5.0.0 gives the correlation -1 for some, where float rounding leaves a negative variance.
    correlation = LOSSES["correlation"]
    for share in np.linspace(0.01, 1.0, 50, dtype=np.float32):
        flat = np.full(BINS, share * np.float32(count), np.float32)
        assert float(correlation(torch.from_numpy(flat), torch.from_numpy(flat))) == 0.0
        assert float(correlation(torch.from_numpy(flat), single_level(3))) == 1.0


@pytest.mark.skipif(not cv2.__version__.startswith("5.0.0"), reason="the fault was seen in OpenCV 5.0.0")
def test_opencv_takes_a_flat_histogram_for_its_own_opposite() -> None:
    flats = [np.full(BINS, share * 4e4, np.float32) for share in np.linspace(0.01, 1.0, 200)]
    wrong = [flat for flat in flats if cv2.compareHist(flat, flat.copy(), cv2.HISTCMP_CORREL) < 0.0]
    assert wrong
    assert all(float(LOSSES["correlation"](torch.from_numpy(flat), torch.from_numpy(flat))) == 0.0 for flat in wrong)


def test_correlation_does_not_cancel_near_its_optimum() -> None:
    # u and u + e d with d orthogonal to u and to constants: 1 - r = 1 - 1 / sqrt(1 + e^2 |d|^2 / |u|^2), about e^2 |d|^2 / (2 |u|^2).
    base = torch.zeros(BINS, dtype=torch.float64)
    base[:4] = torch.tensor([1.0, -1.0, 1.0, -1.0])
    change = torch.zeros_like(base)
    change[:4] = torch.tensor([1.0, 1.0, -1.0, -1.0])
    values = [float(LOSSES["correlation"](1.0 + base, 1.0 + base + 10.0**-power * change)) for power in (3, 6, 7)]
    assert values == pytest.approx([0.5e-6, 0.5e-12, 0.5e-14], rel=1e-3)


def test_intersection_is_half_of_l1_and_misses_what_has_no_mass() -> None:
    first, second = random_histograms(4, seed=5), random_histograms(4, seed=6)
    torch.testing.assert_close(LOSSES["intersection"](first, second), 0.5 * LOSSES["l1"](first, second))


def test_chi_square_overlooks_what_lies_where_the_photograph_is_empty() -> None:
    photograph = 0.999 * single_level(10) + 0.001 * single_level(20)
    nearly = 0.9 * single_level(10) + 0.1 * single_level(20)
    chi_square, symmetric = LOSSES["chi_square"], LOSSES["chi_square_symmetric"]
    assert float(chi_square(nearly, photograph)) > float(chi_square(single_level(200), photograph)) == 1.0
    assert float(symmetric(nearly, photograph)) < float(symmetric(single_level(200), photograph)) == 4.0


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


@pytest.mark.parametrize("shift", [1, 7, 40])
def test_shifting_a_histogram_moves_it_by_as_many_levels(shift: int) -> None:
    histogram = torch.zeros(BINS, dtype=torch.float64)
    histogram[50:150] = random_histograms(seed=8)[:100]
    histogram /= histogram.sum()
    assert float(LOSSES["wasserstein"](histogram.roll(shift), histogram)) == pytest.approx(shift, rel=1e-9)
