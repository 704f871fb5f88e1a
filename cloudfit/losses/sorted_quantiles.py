"""One-dimensional Wasserstein distance by sorted quantiles: differentiable, and without levels.

    W = 255 / n sum_i |v_(i) - Q((i - 1/2) / n)|,    i = 1 .. n

v_(i) are the sorted values of the rendering and Q is the quantile function of the photograph's, a step function. For as many pixels in both
it is the mean difference of the order statistics, the distance itself; otherwise the photograph's cumulative distribution is read at
n places, and the result is off by at most 255 / (2 n) levels times the range of its values.
"""

import torch
from torch import Tensor

from cloudfit.losses.histogram import LAST_LEVEL, WASSERSTEIN
from cloudfit.losses.kinds import PhotographValues, PixelLoss, StandIn


def sample_quantiles(values: Tensor, count: int) -> Tensor:
    """Quantiles of samples at the middles of so many equal shares.

    Args:
        values: (..., sample).
        count: number n of quantiles.

    Returns:
        (..., n) rising: values at the ranks ceil(N (i - 1/2) / n) of N samples; the sorted values themselves for n = N.
    """
    size = values.shape[-1]
    # In integers: floor((2 i + 1) N / (2 n)) for i from 0 is the rank from 0 without a rounding error that could skip one.
    rank = ((2 * torch.arange(count, device=values.device) + 1) * size) // (2 * count)
    return values.sort(dim=-1).values[..., rank]


def sorted_wasserstein_distance(values: Tensor, target: Tensor) -> Tensor:
    """Mean distance in levels between equally ranked pixels.

    Args:
        values: display values 0..1 (..., channel, pixel).
        target: quantiles of the photograph's, as many as there are pixels (channel, pixel).

    Returns:
        (..., channel) in 0..255, float64 [level].
    """
    return LAST_LEVEL * (values.sort(dim=-1).values - target.to(values)).abs().double().mean(dim=-1)


def _quantiles_of_clouds(photograph: PhotographValues) -> Tensor:
    return sample_quantiles(photograph.cloud, photograph.in_place.shape[-1])


SORTED_WASSERSTEIN = PixelLoss(
    "sorted_wasserstein",
    0.0,
    LAST_LEVEL,
    "level",
    "pixel",
    False,
    _quantiles_of_clouds,
    sorted_wasserstein_distance,
    # Sorting is slow and levels are counted fast; rounding to a level moves no pixel by more than half of one. For 20 random candidates the
    # loss ended 0.0014 levels above that of an exact search on average, 0.06 at worst, in losses of about 9.
    air_stand_in=StandIn(WASSERSTEIN, is_soft=False),
)
