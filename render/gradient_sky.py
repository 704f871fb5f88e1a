"""A plain clear sky: a gradient from horizon to zenith and a glow around the sun, reddened by the air as the sun sinks.

It is a backdrop, not a model of the atmosphere: two colours, mixed by the slope of the ray, times what the air leaves of the sunlight.
"""

import math

from torch import Tensor

from render.camera import Vector
from render.units import degrees_from_radians

RAYLEIGH_DEPTHS = (0.06, 0.10, 0.21)
"""Vertical optical depth of the molecules of the air at 620, 550 and 460 nm [1] (Bodhaine et al. 1999, table 3, rounded)."""

ZENITH, HORIZON = (0.13, 0.28, 0.62), (0.55, 0.72, 0.92)
"""Radiance of the sky under a high sun, relative to a white surface that faces the sun [1]; chosen by eye."""

GLOW, GLOW_SHARPNESS = 0.6, 250.0
"""Radiance of the glow in the middle of the sun, and the power of (1 + cosine) / 2 with which it falls; by eye."""

SKY_OF_TWILIGHT = 0.1
"""Share of the sky's light that is left when the sun is level; chosen by eye."""


def air_mass(elevation: float) -> float:
    """Length of the sun's path through the air over that overhead [1]: Kasten and Young 1989, equation 3.

    Args:
        elevation: of the sun [rad]; below the horizon that of the horizon.

    Returns:
        1 overhead, 38 at the horizon.
    """
    degrees = max(degrees_from_radians(elevation), 0.0)
    return 1.0 / (math.sin(math.radians(degrees)) + 0.50572 * (degrees + 6.07995) ** -1.6364)


def sunlight_through_air(elevation: float) -> Vector:
    """Share of the sunlight that clear air lets through, red, green and blue [1], from the elevation of the sun [rad]."""
    mass = air_mass(elevation)
    red, green, blue = (math.exp(-depth * mass) for depth in RAYLEIGH_DEPTHS)
    return (red, green, blue)


def look_up_gradient_sky(direction: Tensor, sun_direction: Tensor, sunlight: Tensor) -> Tensor:
    """Radiance of the sky.

    Args:
        direction: unit directions of view `(..., 3)`.
        sun_direction: unit vector towards the sun `(3,)`.
        sunlight: radiance of a white surface that faces the sun `(channel,)` [1].

    Returns:
        Radiance `(..., channel)` in the unit of `sunlight`; below the horizon that of the horizon.
    """
    slope = direction[..., 2:].clamp(min=0.0)
    zenith, horizon = direction.new_tensor(ZENITH), direction.new_tensor(HORIZON)
    sun_slope = float(sun_direction[2])
    day = SKY_OF_TWILIGHT + (1.0 - SKY_OF_TWILIGHT) * min(max(sun_slope, 0.0) / 0.5, 1.0)
    clear = horizon + (zenith - horizon) * slope**0.45
    # A low sun colours the sky on its own side, and there near the horizon.
    facing = (0.5 + 0.5 * (direction * sun_direction).sum(-1, keepdim=True)).clamp(0.0, 1.0)
    tint = sunlight / sunlight.max().clamp(min=1e-6)
    mix = facing * (1.0 - slope) ** 4 * (1.0 - day)
    glow = GLOW * facing**GLOW_SHARPNESS * sunlight
    return day * clear * (1.0 - mix + mix * tint) + mix * tint * 0.5 * sunlight.max() + glow
