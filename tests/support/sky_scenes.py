"""Made-up photographs whose clouds are known: a blue gradient, white blobs, and rough ground."""

import numpy as np
import torch
from torch import Tensor

from render.colour import srgb_to_linear


def cloudy_scene(height: int = 160, width: int = 240, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Linear pixels (height, width, 3) of blue sky with three white clouds over dark green ground, and its two masks.

    Returns:
        Pixels, cloud (height, width) bool, ground (height, width) bool.
    """
    generator = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width]
    fall = (y / height)[..., None]
    display = np.array([0.25, 0.45, 0.80]) * (1.0 - fall) + np.array([0.50, 0.65, 0.88]) * fall
    cloud = np.zeros((height, width), bool)
    for centre_y, centre_x, radius in ((0.25, 0.3, 0.16), (0.32, 0.7, 0.2), (0.5, 0.45, 0.1)):
        cloud |= ((y / height - centre_y) * 1.4) ** 2 + ((x - centre_x * width) / height) ** 2 < radius**2
    shade = 0.88 + 0.06 * np.sin(x / 7.0) * np.cos(y / 5.0)
    display[cloud] = shade[cloud, None] * np.array([1.0, 0.99, 0.98])
    ground = y >= 0.75 * height
    display[ground] = np.array([0.16, 0.24, 0.08]) * generator.uniform(0.4, 1.8, (height, width, 1))[ground]
    display = np.clip(display + generator.normal(0.0, 0.004, display.shape), 0.0, 1.0)
    pixels = srgb_to_linear(torch.from_numpy(display).float())
    return pixels, torch.from_numpy(cloud & ~ground), torch.from_numpy(ground)


def clear_scene(height: int = 160, width: int = 240) -> Tensor:
    """Linear pixels (height, width, 3) of a clear blue sky alone."""
    fall = torch.linspace(0.0, 1.0, height)[:, None, None]
    top, bottom = torch.tensor([0.2, 0.4, 0.8]), torch.tensor([0.45, 0.62, 0.88])
    return srgb_to_linear((top * (1.0 - fall) + bottom * fall).expand(height, width, 3).contiguous())
