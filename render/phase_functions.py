"""The Henyey-Greenstein phase function: evaluate, sample, density.

Directions are those of travel; the cosine is 1 for scattering straight ahead. Henyey & Greenstein 1941, "Diffuse radiation
in the galaxy", equation 2, normalised here to integrate to one over the sphere:

    p(c; g) = (1 - g^2) / (4 pi (1 + g^2 - 2 g c)^(3/2))

c is the cosine of the scattering angle and g the asymmetry, the mean cosine. Written below with the identity
1 + g^2 - 2 g c = (1 - |g|)^2 + 2 |g| (1 - sign(g) c), which does not cancel in the forward peak.
"""

import math

import torch
from torch import Tensor

from render.errors import ParameterError

LARGEST_ASYMMETRY = 0.999
"""Closer to +-1 the lobe is narrower than float32 resolves; the limit itself is a delta function, not a density."""


def check_asymmetry(asymmetry: Tensor | float) -> None:
    """Raise ParameterError for an asymmetry that is not a number or beyond +-0.999, where the lobe becomes a delta function."""
    value = torch.as_tensor(asymmetry)
    if not bool((value.abs() <= LARGEST_ASYMMETRY).all()):
        worst = float(value.reshape(-1)[value.abs().nan_to_num(nan=2.0).argmax()])
        raise ParameterError(
            f"asymmetry {worst:.6g} is outside -{LARGEST_ASYMMETRY}..{LARGEST_ASYMMETRY}; at +-1 the phase function is a delta "
            "function: scattering straight ahead is the same as a cloud of smaller extinction"
        )


def evaluate_phase_function(cosine: Tensor, asymmetry: Tensor | float) -> Tensor:
    """Henyey-Greenstein phase function [1/sr], also its own density over solid angle.

    Args:
        cosine: of the angle between the directions of travel before and after, any shape.
        asymmetry: mean cosine g in -0.999..0.999, broadcast against `cosine`.

    Returns:
        p(c; g), broadcast shape; integrates to one over the sphere.
    """
    g = torch.as_tensor(asymmetry, dtype=cosine.dtype, device=cosine.device)
    peak = (1.0 - g.abs()) ** 2 + 2.0 * (g.abs() - g * cosine).clamp(min=0.0)
    return (1.0 - g * g) / (4.0 * math.pi) * peak ** (-1.5)


def sample_phase_cosine(asymmetry: Tensor, uniform: Tensor) -> Tensor:
    """Cosine of the scattering angle by inversion of the cumulative distribution.

        c = (1 + g^2 - ((1 - g^2) / (1 + g xi))^2) / (2 g),   xi = 2 u - 1;   c = xi at g = 0

    Rewritten as c = xi + g (1 - xi^2) (1/2 + ...) so that no sign and no size of g cancels: with q = (1 - g^2)/(1 + g xi),
    1 - q = g (g + xi)/(1 + g xi), hence c = ((1 + q) (g + xi)/(1 + g xi) + g) / 2.

    Args:
        asymmetry: g, broadcast against `uniform`.
        uniform: numbers in 0..1.

    Returns:
        Cosines in -1..1, density 2 pi p(c; g).
    """
    g, xi = asymmetry, 2.0 * uniform - 1.0
    q = (1.0 - g * g) / (1.0 + g * xi)
    return (0.5 * ((1.0 + q) * (g + xi) / (1.0 + g * xi) + g)).clamp(-1.0, 1.0)


def rotate_direction(direction: Tensor, cosine: Tensor, azimuth: Tensor) -> Tensor:
    """Direction at a given angle from another one.

    The frame around the direction is Duff et al. 2017, "Building an orthonormal basis, revisited", which has no singularity.

    Args:
        direction: unit vectors `(ray, 3)`.
        cosine: of the angle to turn by `(ray,)`.
        azimuth: angle around the direction `(ray,)` [rad].

    Returns:
        Unit vectors `(ray, 3)`.
    """
    x, y, z = direction.unbind(-1)
    sign = torch.where(z >= 0, 1.0, -1.0).to(z.dtype)
    a = -1.0 / (sign + z)
    b = x * y * a
    sine = ((1.0 - cosine) * (1.0 + cosine)).clamp(min=0.0).sqrt()
    u, v = sine * torch.cos(azimuth), sine * torch.sin(azimuth)
    turned = torch.stack(
        [
            u * (1.0 + sign * x * x * a) + v * b + cosine * x,
            u * (sign * b) + v * (sign + y * y * a) + cosine * y,
            -u * (sign * x) - v * y + cosine * z,
        ],
        dim=-1,
    )
    return turned / torch.linalg.vector_norm(turned, dim=-1, keepdim=True)


def sample_directions(direction: Tensor, asymmetry: Tensor, generator: torch.Generator) -> Tensor:
    """Directions drawn from the Henyey-Greenstein lobe around given ones.

    Args:
        direction: unit vectors `(ray, 3)`.
        asymmetry: g of each lobe `(ray,)`.
        generator: source of the random numbers.

    Returns:
        Unit vectors `(ray, 3)`.
    """
    uniform = torch.rand(2, direction.shape[0], generator=generator, device=direction.device, dtype=direction.dtype)
    return rotate_direction(direction, sample_phase_cosine(asymmetry, uniform[0]), 2.0 * math.pi * uniform[1])
