"""The value of a loss below which there is nothing to be seen: two images of equal appearance are that far apart by chance."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from render.errors import ParameterError

DRAWS = 24
"""Pairs of samples behind a sampled floor: its standard error is about a fiftieth of it."""


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


def sampled_floor(
    distance: Callable[[Tensor, Tensor], Tensor], values: Tensor, pixel_count: int, seed: int = 0
) -> Tensor:
    """Expected loss between two images of equal appearance whose pixels are unrelated, by drawing such images.

    For losses without a closed form. Both images take their pixels from the same values, with replacement, each
    channel by itself.

    Args:
        distance: two images' values (channel, pixel), (channel, pixel) -> (channel,).
        values: of the photograph's cloud pixels (channel, sample).
        pixel_count: number of pixels of each image.
        seed: of the draws.

    Returns:
        (channel,) float64 [unit of the loss]: mean of `DRAWS` pairs.

    Raises:
        ParameterError: when there is no pixel.
    """
    if pixel_count < 1 or values.shape[-1] < 1:
        raise ParameterError(f"expected at least one pixel, got {pixel_count} of {values.shape[-1]}")
    generator = torch.Generator().manual_seed(seed)

    def draw() -> Tensor:
        return values.gather(-1, torch.randint(values.shape[-1], (len(values), pixel_count), generator=generator))

    return torch.stack([distance(draw(), draw()).double() for _ in range(DRAWS)]).mean(0)
