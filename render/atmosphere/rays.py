"""Rays of a camera within the air, from vectors."""

import torch
from torch import Tensor

from render.atmosphere.air_ray import AirRay
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.ray_geometry import clamp_cosine, clamp_radius
from render.errors import ParameterError

ROUNDING = 1e-12
"""Share of the radius that a position on a boundary may lie beyond it, by rounding alone."""


def rays_from_vectors(atmosphere: AtmosphereParameters, position: Tensor, direction: Tensor, sun: Tensor) -> AirRay:
    """Rays of a camera within the air.

    Args:
        atmosphere: the planet.
        position: of the camera relative to the planet's centre `(ray, 3)` [m], float64.
        direction: unit vectors of the rays `(ray, 3)`.
        sun: unit vectors towards the sun, `(ray, 3)` or `(3,)`.

    Returns:
        The rays.

    Raises:
        ParameterError: if a position is not within the air.
    """
    position, direction, sun = torch.broadcast_tensors(position, direction, sun)
    radius = torch.linalg.vector_norm(position, dim=-1)
    slack = ROUNDING * atmosphere.top_radius
    outside = ~((radius >= atmosphere.bottom_radius - slack) & (radius <= atmosphere.top_radius + slack))
    if bool(outside.any()):
        raise ParameterError(
            f"a camera stands between {atmosphere.bottom_radius} and {atmosphere.top_radius} m from the planet's centre, "
            f"not at {float(radius[outside][0])} m"
        )
    zenith = position / radius[..., None]
    cosine, radius = clamp_cosine((zenith * direction).sum(-1)), clamp_radius(atmosphere, radius)
    cos_sun, cos_view_sun = clamp_cosine((zenith * sun).sum(-1)), clamp_cosine((direction * sun).sum(-1))
    return AirRay.towards(atmosphere, radius, cosine, cos_sun, cos_view_sun)


def chosen_rays(rays: AirRay, chosen: Tensor) -> AirRay:
    """Some rays of `(ray,)`, by number or mask."""
    return AirRay(*(values[chosen] for values in rays.tensors()))
