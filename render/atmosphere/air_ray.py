"""Rays through the air, as the four numbers that scattered light depends on, and the question of the ground decided once."""

from dataclasses import dataclass

import torch
from torch import Tensor

from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.ray_geometry import (
    distance_to_nearest_boundary,
    radius_along_ray,
    ray_intersects_ground,
    sun_cosine_along_ray,
    view_cosine_along_ray,
)


@dataclass(frozen=True, eq=False)
class AirRay:
    """Rays that start within the air; all tensors broadcast against each other.

    Args:
        radius: r, of the origin from the centre of the planet `(...)` [m].
        cos_view: mu, cosine between ray and zenith `(...)`.
        cos_sun: mu_s, cosine between sun and zenith `(...)`.
        cos_view_sun: nu, cosine between ray and sun `(...)`.
        intersects_ground: whether the ray meets the ground `(...)`.
    """

    radius: Tensor
    cos_view: Tensor
    cos_sun: Tensor
    cos_view_sun: Tensor
    intersects_ground: Tensor

    @staticmethod
    def towards(
        atmosphere: AtmosphereParameters, radius: Tensor, cos_view: Tensor, cos_sun: Tensor, cos_view_sun: Tensor
    ) -> "AirRay":
        """Rays of which it is yet to be decided whether they meet the ground."""
        ground = ray_intersects_ground(atmosphere, radius, cos_view)
        return AirRay(radius, cos_view, cos_sun, cos_view_sun, ground)

    def at(self, atmosphere: AtmosphereParameters, distance: Tensor) -> "AirRay":
        """The same rays, looked at from a point further on.

        Args:
            atmosphere: the planet.
            distance: along the ray `(...)` [m].

        Returns:
            Rays of the broadcast shape that meet the ground if these do.
        """
        radius = radius_along_ray(atmosphere, self.radius, self.cos_view, distance)
        return AirRay(
            radius,
            view_cosine_along_ray(self.radius, self.cos_view, distance, radius),
            sun_cosine_along_ray(self.radius, self.cos_sun, self.cos_view_sun, distance, radius),
            self.cos_view_sun,
            self.intersects_ground,
        )

    def length(self, atmosphere: AtmosphereParameters) -> Tensor:
        """Distance to where the rays leave the air `(...)` [m]."""
        return distance_to_nearest_boundary(atmosphere, self.radius, self.cos_view, self.intersects_ground)

    def unsqueeze(self) -> "AirRay":
        """The same rays with a last dimension of one, to be met by points along each."""
        return AirRay(*(value.unsqueeze(-1) for value in self.tensors()))

    def expanded(self) -> "AirRay":
        """The same rays, all tensors of the broadcast shape."""
        return AirRay(*torch.broadcast_tensors(*self.tensors()))

    def tensors(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """The members in their order."""
        return self.radius, self.cos_view, self.cos_sun, self.cos_view_sun, self.intersects_ground
