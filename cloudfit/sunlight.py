"""Colour of the sunlight, read off the bright side of the clouds (section 4.1 of the paper)."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from cloudfit.cloud_mask import CloudMask
from render.colour import linear_to_srgb, srgb_to_linear


@dataclass(frozen=True)
class Sunlight:
    """Light that the clouds receive.

    Attributes:
        colour: (channel,) colour of the sunlight, largest channel 1 [1].
        grey_threshold: linear grey above which a cloud pixel counts as sunlit [1].
        bright_fraction: share of the cloud pixels that are sunlit [1].
        ambient_sky_colour: (channel,) mean colour of the clear sky, largest channel 1; `colour` where no sky is seen.
    """

    colour: Tensor
    grey_threshold: float
    bright_fraction: float
    ambient_sky_colour: Tensor


def estimate_sunlight(pixels: Tensor, mask: CloudMask) -> Sunlight:
    """Split the cloud pixels by Otsu's threshold on their grey value; the mean colour of the brighter class is the sun's.

    The grey value is the mean of the channels, thresholded in 256 steps of the sRGB curve, clipped at display white: an
    unclipped sun seen through the clouds would outweigh them.

    Args:
        pixels: (height, width, channel) linear light [1], display white is 1.
        mask: labels of the same size, with at least one cloud pixel.

    Returns:
        The sunlight.

    Raises:
        ValueError: the mask holds no cloud.
    """
    if not mask.cloud.any():
        raise ValueError("expected a mask with cloud pixels, got none; check cloud_fraction first")
    cloud = pixels[mask.cloud].clamp(0.0, 1.0)
    grey = cloud.mean(dim=1)
    levels = torch.round(255.0 * linear_to_srgb(grey[:, None].expand(-1, 3))[:, 0]).to(torch.uint8)
    threshold, _ = cv2.threshold(np.ascontiguousarray(levels.numpy()), 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    bright = levels > threshold
    if not bright.any():
        # One grey level: every pixel is as bright as any.
        bright = torch.ones_like(bright)
    colour = _normalised(cloud[bright])
    return Sunlight(
        colour=colour,
        grey_threshold=float(srgb_to_linear(torch.full((3,), threshold / 255.0))[0]),
        bright_fraction=float(bright.double().mean()),
        ambient_sky_colour=_normalised(pixels[mask.sky].clamp(0.0, 1.0)) if mask.sky.any() else colour,
    )


def _normalised(colours: Tensor) -> Tensor:
    """Mean of (pixel, channel) colours, scaled to a largest channel of 1; white for black."""
    mean = colours.double().mean(dim=0)
    largest = mean.max()
    return (mean / largest if largest > 0.0 else torch.ones_like(mean)).to(colours.dtype)
