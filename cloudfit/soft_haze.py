"""Soft histograms of a whole population of rendered clouds behind several amounts of air."""

import numpy as np
import torch
from torch import Tensor

from cloudfit.colour_histogram import SQUARE_ROOT, STEPS, build_level_table
from cloudfit.losses.soft_histogram import soft_histogram
from render.cloud_image import blend_air
from render.colour import DISPLAY_CURVES
from render.fused import fused_loops_wanted


def display_values(linear: Tensor, display_curve: str) -> Tensor:
    """Linear light, held to 0..1, as display values 0..1; any shape, differentiable within the range."""
    held = linear.clamp(0.0, 1.0)
    # Every curve treats each value alone, and wants them in rows of three.
    padded = torch.nn.functional.pad(held.flatten(), (0, -held.numel() % 3)).unflatten(0, (-1, 3))
    return DISPLAY_CURVES[display_curve](padded).flatten()[: held.numel()].reshape(held.shape)


@torch.no_grad()
def soft_haze_histograms(cloud: Tensor, sky: Tensor, air_depth: Tensor, display_curve: str) -> Tensor:
    """Two-bin linear soft histograms of clouds in haze, without gradients.

    With numba, levels are read from the table of `haze_histograms`, of 256 steps a level: a pixel's place between two levels is off by
    1/250 of a level at most.

    Args:
        cloud: linear light `(population, channel, pixel)`, finite.
        sky: linear light behind it `(channel, pixel)`, finite.
        air_depth: optical depth of the air `(population, kappa, channel)`.
        display_curve: name of one of the `DISPLAY_CURVES`.

    Returns:
        `(population, kappa, channel, bin)` float64, each sums to 1.
    """
    if fused_loops_wanted():
        from cloudfit.fused_histogram import share_hazes  # needs numba

        table = build_level_table(display_curve)
        clouds, skies, haze = (
            t.detach().to(torch.float32).contiguous().numpy() for t in (cloud, sky, torch.exp(-air_depth))
        )
        counts = share_hazes(clouds, skies, haze, table.positions, table.bend is SQUARE_ROOT, STEPS)
        return torch.from_numpy(counts / np.float64(cloud.shape[-1]))
    # One amount of air at a time: the hazy images of all would be eleven times the memory of the clouds.
    histograms = [
        soft_histogram(display_values(blend_air(cloud, sky, depth.to(cloud.dtype)), display_curve))
        for depth in air_depth.unbind(1)
    ]
    return torch.stack(histograms, dim=1)
