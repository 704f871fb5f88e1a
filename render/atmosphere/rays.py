"""Rays in the air as integrals see them: where they begin and end, and where the sun stands, without any axes."""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.ray_geometry import (
    clamp_cosine,
    clamp_radius,
    distance_to_nearest_boundary,
    ray_intersects_ground,
)
from render.errors import ParameterError

ROUNDING = 1e-12
"""Share of the radius that a position on a boundary may lie beyond it, by rounding alone."""


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays in the air as the integrals see them.

    Args:
        radius: of the origins from the centre `(ray,)` [m], float64.
        cosine: between ray and zenith at the origin `(ray,)`.
        cos_sun_zenith: between sun and zenith at the origin `(ray,)`.
        cos_view_sun: between ray and sun `(ray,)`.
        intersects_ground: whether the ray ends on the ground `(ray,)`, bool.
    """

    radius: Tensor
    cosine: Tensor
    cos_sun_zenith: Tensor
    cos_view_sun: Tensor
    intersects_ground: Tensor

    def __post_init__(self) -> None:
        shapes = {tuple(getattr(self, field.name).shape) for field in fields(self)}
        if len(shapes) != 1 or len(shapes.pop()) != 1:
            raise ParameterError("rays need one number each of radius, cosines and the ground, all of one shape (ray,)")
        if self.radius.dtype != torch.float64:
            raise ParameterError(f"distances from a planet's centre need float64, not {self.radius.dtype}")

    def __getitem__(self, chosen: Tensor) -> "Rays":
        """Some of the rays, by number or mask."""
        return Rays(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def __len__(self) -> int:
        return len(self.radius)

    def end(self, atmosphere: AtmosphereParameters) -> Tensor:
        """Distance to the ground or to the top of the air `(ray,)` [m]."""
        return distance_to_nearest_boundary(atmosphere, self.radius, self.cosine, self.intersects_ground)


def rays_from_vectors(atmosphere: AtmosphereParameters, position: Tensor, direction: Tensor, sun: Tensor) -> Rays:
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
    cosine = clamp_cosine((zenith * direction).sum(-1))
    radius = clamp_radius(atmosphere, radius)
    return Rays(
        radius,
        cosine,
        clamp_cosine((zenith * sun).sum(-1)),
        clamp_cosine((direction * sun).sum(-1)),
        ray_intersects_ground(atmosphere, radius, cosine),
    )
