"""Light on a surface at any altitude and of any slope, summed over all that is seen from there."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.atmosphere.ground_light import look_up_ground_radiance
from render.atmosphere.ray_geometry import distance_to_bottom_boundary
from render.atmosphere.shells import gauss_legendre
from render.atmosphere.sky import enter_air
from render.atmosphere.sky_view import SkyView, horizon_angle, look_up_sky_view
from render.atmosphere.sun_columns import look_up_sunlight

POLAR_NODES, TURNS = 48, 96
"""Directions on each side of the horizon, and around: of the sky's irradiance they leave out at most 2e-4."""


@dataclass(frozen=True, eq=False)
class SurfaceLight:
    """Light that falls on surfaces, each `(surface, wavelength)` [W/m^2/nm].

    Args:
        sun: directly.
        sky: scattered by the air.
        ground: reflected by the ground.
    """

    sun: Tensor
    sky: Tensor
    ground: Tensor


def compute_surface_irradiance(view: SkyView, normal: Tensor) -> SurfaceLight:
    """Light that falls on surfaces where a camera stands.

        E = integral of L(w) max(0, n . w) dw

    by Gauss-Legendre nodes in the cosine from the zenith on each side of the horizon, where light jumps, and equal steps around.

    Args:
        view: of a camera at the place of the surfaces.
        normal: unit normals `(surface, 3)`.

    Returns:
        Irradiance by the sun, the air and the ground.
    """
    planet = view.atmosphere
    normal = torch.nn.functional.normalize(normal.double(), dim=-1)
    direction, weight = _directions(view)
    seen, ground = look_up_sky_view(view, direction)
    facing = (normal @ direction.T).clamp(min=0.0) * weight
    below = direction[ground]
    distance = distance_to_bottom_boundary(planet, torch.linalg.vector_norm(view.eye), below[:, 2])
    upright = torch.nn.functional.normalize(view.eye + distance[:, None] * below, dim=-1)
    reflected = seen.transmittance[ground] * look_up_ground_radiance(view.source, upright @ view.sun)
    direct = (normal @ view.sun).clamp(min=0.0)[:, None] * _sunlight(view)
    return SurfaceLight(direct, facing @ seen.radiance, facing[:, ground] @ reflected)


def _sunlight(view: SkyView) -> Tensor:
    """Irradiance of a surface that faces the sun `(wavelength,)` [W/m^2/nm], also of one beyond the air."""
    planet = view.atmosphere
    ray, _, misses = enter_air(planet, view.eye, view.sun, view.sun)
    share = look_up_sunlight(view.source.sun_columns, view.source.shells.extinction, ray.radius, ray.cos_sun)
    return torch.where(misses, 1.0, share) * torch.tensor(planet.solar_irradiance, dtype=torch.float64)


def _directions(view: SkyView) -> tuple[Tensor, Tensor]:
    """Directions `(ray, 3)` and the solid angle of each `(ray,)` [sr]."""
    horizon = math.cos(horizon_angle(view.atmosphere, view.altitude))
    node, weight = gauss_legendre(POLAR_NODES)
    cosine = torch.cat([-1.0 + (horizon + 1.0) * node, horizon + (1.0 - horizon) * node])
    solid = torch.cat([(horizon + 1.0) * weight, (1.0 - horizon) * weight]) * (2.0 * math.pi / TURNS)
    turn = (torch.arange(TURNS, dtype=torch.float64) + 0.5) * (2.0 * math.pi / TURNS)
    level = (1.0 - cosine.square()).sqrt()[:, None]
    parts = (level * torch.sin(turn), level * torch.cos(turn), cosine[:, None].expand(-1, TURNS))
    return torch.stack(parts, -1).reshape(-1, 3), solid[:, None].expand(-1, TURNS).reshape(-1)
