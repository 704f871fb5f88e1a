"""The Rayleigh phase function, of particles much smaller than the wavelength: evaluate and sample.

    p(c) = 3 / (16 pi) (1 + c^2)

c is the cosine between the directions of travel before and after (Rayleigh 1871; Bruneton & Neyret 2008, section 2.1), without the
depolarisation of real air. Its mean cosine is zero.
"""

import math

import torch
from torch import Tensor


def evaluate_rayleigh_phase(cosine: Tensor) -> Tensor:
    """Rayleigh phase function [1/sr], also its own density over solid angle.

    Args:
        cosine: of the angle between the directions of travel before and after, any shape.

    Returns:
        p(c), same shape; integrates to one over the sphere.
    """
    return 3.0 / (16.0 * math.pi) * (1.0 + cosine * cosine)


def sample_rayleigh_cosine(uniform: Tensor) -> Tensor:
    """Cosine of the scattering angle by inversion of the cumulative distribution.

    The distribution (c^3 + 3 c + 4) / 8 = u is a cubic with one real root, c = 2 sinh(asinh(4 u - 2) / 3).

    Args:
        uniform: numbers in [0, 1), any shape.

    Returns:
        Cosines in -1..1, density 2 pi p(c).
    """
    return (2.0 * torch.sinh(torch.asinh(4.0 * uniform - 2.0) / 3.0)).clamp(-1.0, 1.0)
