"""How rays towards the sun leave round ground, to first order in height over radius.

A straight ray of slope l above a sphere of radius R rises by l s + kappa s^2 / 2 in a distance s, with kappa = (1 -
l^2) / R. The next term is smaller by s / R, so the parabola serves for media much thinner than R. The ground is where
the layer has its base.
"""

import torch
from torch import Tensor

EARTH_RADIUS = 6_371_000.0
"""Mean radius of the earth [m] (IUGG)."""


def curvature(slope: Tensor, radius: float) -> Tensor:
    """Second derivative of the height along a straight ray [1/m], from its slope [1] and the radius of the ground [m]."""
    return (1.0 - slope) * (1.0 + slope) / radius


def distance_to_top(above: Tensor, slope: Tensor, radius: float) -> Tensor:
    """Distance at which a ray has risen to the top of a layer.

        D = l S + kappa S^2 / 2   =>   S = 2 D / (l + sqrt(l^2 + 2 kappa D)), or with l < 0: (sqrt(...) - l) / kappa

    Args:
        above: D, how far the top lies above the beginning of the ray [m], not negative.
        slope: l, vertical component of the unit direction where the ray begins [1].
        radius: of the ground [m].

    Returns:
        Distance [m]; 0 straight down, where the ray ends in the ground.
    """
    above, slope = torch.broadcast_tensors(above, slope)
    kappa = curvature(slope, radius)
    square = slope.square() + 2.0 * kappa * above
    root = torch.where(square > 0.0, torch.where(square > 0.0, square, 1.0).sqrt(), 0.0)
    rises, bent = slope > 0.0, kappa > 0.0
    rising = 2.0 * above / torch.where(rises, slope + root, 1.0)
    return torch.where(rises, rising, torch.where(bent, (root - slope) / torch.where(bent, kappa, 1.0), 0.0))


def shadowed(height: Tensor, ground: Tensor | float, slope: Tensor, radius: float) -> Tensor:
    """Whether the ground hides the sun.

    A falling ray is lowest at s = -l / kappa, l^2 / (2 kappa) below its beginning.

    Args:
        height: of the beginning of the ray [m].
        ground: height of the ground [m]; minus infinity for none.
        slope: of the ray towards the sun [1].
        radius: of the ground [m].

    Returns:
        Booleans of the broadcast shape.
    """
    dip = slope.square() > 2.0 * curvature(slope, radius) * (height - ground).clamp(min=0.0)
    return (slope < 0.0) & dip
