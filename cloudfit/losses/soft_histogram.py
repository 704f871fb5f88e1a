"""L1 distance of two-bin linear soft histograms: every pixel is shared between the two levels next to it.

    h_b = (1 / n) sum_q max(0, 1 - |255 v_q - b|)

A hard histogram is constant but for its jumps; this one is piecewise linear in every pixel's value v_q, so that the loss has a gradient
almost everywhere. It is what Dobashi et al.'s L1 objective becomes when a pixel passes from one level to the next gradually.
"""

import torch
from torch import Tensor

from cloudfit.losses.histogram import L1
from cloudfit.losses.kinds import PhotographValues, PixelLoss, StandIn

LEVELS = 256


def soft_histogram(values: Tensor) -> Tensor:
    """Histogram in which every pixel counts in the levels below and above it, with weights that fall linearly.

    Args:
        values: display values 0..1 (..., pixel); held at the ends, where the gradient of what lies beyond is zero.

    Returns:
        (..., bin) float64, sums to 1; NaN in some bin if any value is NaN.
    """
    position = values.clamp(0.0, 1.0) * (LEVELS - 1)
    below = position.detach().nan_to_num().floor().clamp(max=LEVELS - 2)
    above_share = (position - below).double()
    level = below.long()
    counts = torch.zeros(*values.shape[:-1], LEVELS, dtype=torch.float64, device=values.device)
    counts = counts.scatter_add(-1, level, 1.0 - above_share).scatter_add(-1, level + 1, above_share)
    return counts / values.shape[-1]


def soft_l1_distance(values: Tensor, target: Tensor) -> Tensor:
    """Sum of absolute differences of the soft histograms.

    Args:
        values: display values 0..1 (..., channel, pixel).
        target: the photograph's soft histogram (channel, bin).

    Returns:
        (..., channel) in 0..2, float64 [1].
    """
    return (soft_histogram(values) - target).abs().sum(dim=-1)


def _soft_histogram_of_clouds(photograph: PhotographValues) -> Tensor:
    return soft_histogram(photograph.cloud)


SOFT_L1 = PixelLoss(
    "soft_l1", 0.0, 2.0, "1", "bin", False, _soft_histogram_of_clouds, soft_l1_distance, StandIn(L1, is_soft=True)
)
