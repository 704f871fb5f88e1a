"""Losses between two colour histograms, and the value of the L1 loss below which there is nothing to be seen."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import torch
from torch import Tensor

from render.errors import ParameterError

LAST_LEVEL = 255.0


@dataclass(frozen=True)
class Loss:
    """A distance between histograms: what to compute, its best value and its worst.

    Args:
        name: key in `LOSSES`.
        optimum: value for two equal histograms.
        worst: value for two histograms as different as can be.
        unit: unit of the value.
        distance: (..., bin) and (..., bin), broadcast, in float64 -> (...).
    """

    name: str
    optimum: float
    worst: float
    unit: str
    distance: Callable[[Tensor, Tensor], Tensor]

    def __call__(self, histogram: Tensor, target: Tensor) -> Tensor:
        """Distance of each histogram from the target's; a histogram with NaN has the loss NaN.

        Args:
            histogram: (..., bin), each sums to 1.
            target: (..., bin), leading dimensions that broadcast against those of `histogram`.

        Returns:
            (...) float64 [unit]. The mean over channels is the caller's.

        Raises:
            ParameterError: when the shapes do not fit each other.
        """
        try:
            torch.broadcast_shapes(histogram.shape, target.shape)
            same_bins = histogram.ndim > 0 and target.ndim > 0 and histogram.shape[-1] == target.shape[-1]
        except RuntimeError:
            same_bins = False
        if not same_bins:
            raise ParameterError(
                f"{self.name}: expected two histograms (..., bin) with as many bins and leading dimensions that "
                f"broadcast, got {tuple(histogram.shape)} and {tuple(target.shape)}"
            )
        return self.distance(histogram.double(), target.double())


def l1_distance(histogram: Tensor, target: Tensor) -> Tensor:
    """Sum of absolute differences, the objective of Dobashi et al. 2012, eq. 2.

    sum_b |h_b - h'_b|: twice the share of pixels that would have to change level.

    Args:
        histogram: (..., bin).
        target: (..., bin).

    Returns:
        (...) in 0..2 [1].
    """
    return (histogram - target).abs().sum(dim=-1)


def wasserstein_distance(histogram: Tensor, target: Tensor) -> Tensor:
    """One-dimensional earth mover's distance between histograms of equal mass.

    W = sum_b |F_b - F'_b| with the cumulative sums F: the mean number of levels by which a pixel would have to move.

    Args:
        histogram: (..., bin).
        target: (..., bin).

    Returns:
        (...) in 0..bins - 1 [level].
    """
    return (histogram - target).cumsum(dim=-1).abs().sum(dim=-1)


LOSSES: Mapping[str, Loss] = MappingProxyType(
    {
        "l1": Loss("l1", 0.0, 2.0, "1", l1_distance),
        "wasserstein": Loss("wasserstein", 0.0, LAST_LEVEL, "level", wasserstein_distance),
    }
)


def l1_floor(histogram: Tensor, pixel_count: int) -> Tensor:
    """Expected L1 loss between two images of equal appearance whose pixels are unrelated: differences below it mean nothing.

    Two independent samples of n pixels from the same distribution h have binomial counts X_b, Y_b of mean n h_b. With
    x = n h_b the Poisson limit of E|X_b - Y_b|, the mean modulus of a Skellam variable, is

        2 x exp(-2 x) [I_0(2 x) + I_1(2 x)]

    and (1 - h_b) corrects the variance from Poisson to binomial, so that

        E sum_b |X_b - Y_b| / n  =  sum_b sqrt(1 - h_b) 2 h_b exp(-2 n h_b) [I_0(2 n h_b) + I_1(2 n h_b)].

    For well filled bins this is sum_b 2 sqrt(h_b (1 - h_b) / (pi n)); for a flat histogram of 256 bins
    2 sqrt(256 / (pi n)) = 18 / sqrt(n); a narrow histogram has a lower floor. The Skellam form matters where bins
    hold few pixels: the square root alone would give a floor above the worst loss there.

    Args:
        histogram: (..., bin), each sums to 1; that of the photograph.
        pixel_count: number n of cloud pixels.

    Returns:
        (...) float64 in 0..2 [1].

    Raises:
        ParameterError: when there is no pixel.
    """
    if pixel_count < 1:
        raise ParameterError(f"expected at least one cloud pixel, got {pixel_count}")
    share = histogram.double().clamp(0.0, 1.0)
    mean_count = share * pixel_count
    bessel = torch.special.i0e(2.0 * mean_count) + torch.special.i1e(2.0 * mean_count)
    return ((1.0 - share).sqrt() * 2.0 * share * bessel).sum(dim=-1)


def flat_l1_floor(pixel_count: int, bins: int = 256) -> float:
    """The floor 2 sqrt(bins / (pi n)) of a flat histogram with well filled bins, the largest there is.

    Args:
        pixel_count: number n of cloud pixels.
        bins: number of levels.

    Returns:
        expected L1 loss [1].
    """
    return 2.0 * math.sqrt(bins / (math.pi * pixel_count))
