"""The Cornette-Shanks phase function, of particles larger than the wavelength: evaluate and sample.

Cornette & Shanks 1992, "Physically reasonable analytic expression for the single-scattering phase function", equation 8, normalised
here to integrate to one over the sphere:

    p(c; g) = 3 / (8 pi) (1 - g^2) / (2 + g^2) (1 + c^2) / (1 + g^2 - 2 g c)^(3/2)

c is the cosine between the directions of travel before and after. The parameter g is not the mean cosine, which is
3 g (4 + g^2) / (5 (2 + g^2)). At g = 0 it is the Rayleigh phase function.
"""

import math

import torch
from torch import Tensor

from render.errors import ParameterError
from render.phase_functions import sample_phase_cosine

LARGEST_PARAMETER = 0.999
"""Closer to +-1 the lobe is narrower than float32 resolves."""

NEWTON_STEPS = 60
"""More than bisection needs from an interval of 2 to the spacing of float64; Newton's method needs about six of them."""


def evaluate_cornette_shanks(cosine: Tensor, asymmetry: Tensor | float) -> Tensor:
    """Cornette-Shanks phase function [1/sr], also its own density over solid angle.

    Args:
        cosine: of the angle between the directions of travel before and after, any shape.
        asymmetry: parameter g, -1 < g < 1, broadcast against `cosine`.

    Returns:
        p(c; g), broadcast shape; integrates to one over the sphere.
    """
    g = torch.as_tensor(asymmetry, dtype=cosine.dtype, device=cosine.device)
    # 1 + g^2 - 2 g c without cancellation in the forward peak.
    peak = (1.0 - g.abs()) ** 2 + 2.0 * (g.abs() - g * cosine).clamp(min=0.0)
    scale = 3.0 / (8.0 * math.pi) * (1.0 - g * g) / (2.0 + g * g)
    # A root and a product: several times as fast as a power with the exponent -3/2.
    return scale * (1.0 + cosine * cosine) / (peak * peak.sqrt())


def sample_cornette_shanks_cosine(asymmetry: Tensor | float, uniform: Tensor) -> Tensor:
    """Cosine of the scattering angle by inversion of the cumulative distribution.

    Let h(xi) be the cosine that the Henyey-Greenstein function gives for the number (1 + xi) / 2. The distribution as a function of
    xi has the slope 3 (1 + h^2) / (4 (2 + g^2)), which varies by a factor of two at most, and a closed form (see `_cumulative`).
    Newton's method, bracketed, solves it for xi, and h gives the cosine.

    Args:
        asymmetry: parameter g in -0.999..0.999, broadcast against `uniform`.
        uniform: numbers in [0, 1), any shape.

    Returns:
        Cosines in -1..1, density 2 pi p(c; g), of the type of `uniform`.

    Raises:
        ParameterError: for a parameter that is not a number or beyond +-0.999.
    """
    parameter = torch.as_tensor(asymmetry, dtype=torch.float64, device=uniform.device)
    target, g = torch.broadcast_tensors(uniform.double(), parameter)
    if not bool((g.abs() <= LARGEST_PARAMETER).all()):
        raise ParameterError(
            f"the Cornette-Shanks parameter must lie in -{LARGEST_PARAMETER}..{LARGEST_PARAMETER}, where the lobe still has a "
            f"width; got values from {float(g.min())} to {float(g.max())}"
        )
    low, high = torch.full_like(target, -1.0), torch.ones_like(target)
    xi = 2.0 * target - 1.0
    for _ in range(NEWTON_STEPS):
        excess = _cumulative(xi, g) - target
        low, high = torch.where(excess < 0.0, xi, low), torch.where(excess < 0.0, high, xi)
        step = xi - excess / (0.75 * (1.0 + _greenstein_cosine(xi, g) ** 2) / (2.0 + g * g))
        following = torch.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        moved = (following - xi).abs()
        xi = following
        if not bool((moved > 4.0 * torch.finfo(torch.float64).eps).any()):
            break
    return _greenstein_cosine(xi, g).to(uniform.dtype)


def _greenstein_cosine(xi: Tensor, g: Tensor) -> Tensor:
    return sample_phase_cosine(g, 0.5 * (1.0 + xi))


def _cumulative(xi: Tensor, g: Tensor) -> Tensor:
    """Cornette-Shanks probability below xi: 3 / (4 (2 + g^2)) times the integral of 1 + h^2 from -1.

    With w = 1 + g xi the integral of h^2 is (1 + xi) / (12 g^2 w^3) times a polynomial that g^2 divides; the quotient below is
    written out, so that nothing is lost at small g.
    """
    w = 1.0 + g * xi
    quotient = torch.zeros_like(xi)
    for coefficient in (
        0.25 * (xi + 1.0) ** 2 * (3.0 * xi - 1.0),
        3.0 * xi * (xi + 1.0),
        0.5 * (((3.0 * xi - 1.0) * xi + 7.0) * xi + 5.0),
        (5.0 * xi - 2.0) * xi + 2.0,
        0.75 * (((xi - 1.0) * xi + 7.0) * xi - 3.0),
        (xi - 1.0) * xi + 1.0,
    ):
        quotient = quotient * g + coefficient
    return 0.75 / (2.0 + g * g) * (1.0 + xi) * (1.0 + quotient / (3.0 * w**3))
