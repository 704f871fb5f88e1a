"""How the axes of the atmosphere's tables stand for radii and directions: pairs of functions that invert each other.

Each maps a quantity to 0..1 and back, 0 and 1 being the first and last node of the axis. The mappings are those of Bruneton & Neyret 2008,
section 4, in the form of Bruneton 2017; nodes crowd where light varies fast, near the ground, the horizon and the low sun. Written with
R and r_top, the radii of ground and top; H, the length of a ray that grazes the ground, up to the top; rho = sqrt(r^2 - R^2), the
distance to the horizon. The directions of view are two axes that share one table: rays that meet the ground, and rays that do not. Light
is not continuous at the horizon, and no interpolation may cross it.
"""

import torch
from torch import Tensor

from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.ray_geometry import (
    clamp_cosine,
    distance_to_bottom_boundary,
    distance_to_top_boundary,
    horizon_distance,
)


def unit_from_radius(atmosphere: AtmosphereParameters, radius: Tensor) -> Tensor:
    """Place on the axis of radii, rho / H, of radii [m]: linear in the square root of the altitude near the ground."""
    return horizon_distance(atmosphere, radius) / atmosphere.horizon_length


def radius_from_unit(atmosphere: AtmosphereParameters, unit: Tensor) -> Tensor:
    """Radius [m] of a place on the axis of radii; inverse of `unit_from_radius`."""
    squared = (unit * atmosphere.horizon_length).square()
    radius = (squared + atmosphere.bottom_radius**2).sqrt()
    return radius.clamp(atmosphere.bottom_radius, atmosphere.top_radius)


def unit_from_sky_view(atmosphere: AtmosphereParameters, radius: Tensor, cosine: Tensor) -> Tensor:
    """Place on the axis of rays that miss the ground: 0 for the zenith, 1 for the horizon.

        x = (d - d_min) / (d_max - d_min),   d the distance to the top, d_min = r_top - r,   d_max = rho + H

    Args:
        atmosphere: the planet.
        radius: r `(...)` [m].
        cosine: between ray and zenith `(...)`.

    Returns:
        Places `(...)`, beyond 1 for rays below the horizon.
    """
    shortest = atmosphere.top_radius - radius
    longest = horizon_distance(atmosphere, radius) + atmosphere.horizon_length
    return (distance_to_top_boundary(atmosphere, radius, cosine) - shortest) / (longest - shortest)


def sky_view_from_unit(atmosphere: AtmosphereParameters, unit_radius: Tensor, unit: Tensor) -> Tensor:
    """Cosine between ray and zenith of a place on the axis of rays that miss the ground; inverse of `unit_from_sky_view`.

        mu = (H^2 - rho^2 - d^2) / (2 r d),   1 where d = 0

    Args:
        atmosphere: the planet.
        unit_radius: place on the axis of radii `(...)`.
        unit: places `(...)`.

    Returns:
        Cosines `(...)`.
    """
    radius, horizon = radius_from_unit(atmosphere, unit_radius), atmosphere.horizon_length
    # rho comes from the axis and not from r: a last bit of r is worth 0.1 m of it.
    rho = unit_radius * horizon
    shortest, longest = atmosphere.top_radius - radius, rho + horizon
    distance = shortest + unit * (longest - shortest)
    cosine = ((horizon - rho) * (horizon + rho) - distance.square()) / (2.0 * radius * _or_one(distance))
    return torch.where(distance > 0.0, clamp_cosine(cosine), 1.0)


def unit_from_ground_view(atmosphere: AtmosphereParameters, radius: Tensor, cosine: Tensor) -> Tensor:
    """Place on the axis of rays that meet the ground: 0 for the nadir, 1 for the horizon.

        x = (d - d_min) / (d_max - d_min),   d the distance to the ground, d_min = r - R,   d_max = rho

    Args:
        atmosphere: the planet.
        radius: r `(...)` [m].
        cosine: between ray and zenith `(...)`.

    Returns:
        Places `(...)`; 0 on the ground itself, where all these rays have no length.
    """
    shortest = radius - atmosphere.bottom_radius
    span = horizon_distance(atmosphere, radius) - shortest
    place = (distance_to_bottom_boundary(atmosphere, radius, cosine) - shortest) / _or_one(span)
    return torch.where(span > 0.0, place, 0.0)


def ground_view_from_unit(atmosphere: AtmosphereParameters, unit_radius: Tensor, unit: Tensor) -> Tensor:
    """Cosine between ray and zenith of a place on the axis of rays that meet the ground; inverse of `unit_from_ground_view`.

        mu = -(rho^2 + d^2) / (2 r d),   -1 where d = 0

    Args:
        atmosphere: the planet.
        unit_radius: place on the axis of radii `(...)`.
        unit: places `(...)`.

    Returns:
        Cosines `(...)`.
    """
    radius, rho = radius_from_unit(atmosphere, unit_radius), unit_radius * atmosphere.horizon_length
    shortest = radius - atmosphere.bottom_radius
    distance = shortest + unit * (rho - shortest)
    cosine = -(rho.square() + distance.square()) / (2.0 * radius * _or_one(distance))
    return torch.where(distance > 0.0, clamp_cosine(cosine), -1.0)


def unit_from_sun(atmosphere: AtmosphereParameters, cos_sun: Tensor) -> Tensor:
    """Place on the axis of the sun's height: 0 for the lowest sun that the tables cover, 1 for the zenith.

        x = max(1 - a/A, 0) / (1 + a),   a = (d - d_min) / (H - d_min)

    d is the distance from the ground to the top towards the sun, d_min = r_top - R, and A is a at the lowest sun.

    Args:
        atmosphere: the planet.
        cos_sun: cosine between sun and zenith `(...)`.

    Returns:
        Places `(...)`; 0 for every sun that stands lower than the tables cover.
    """
    a = _sun_path(atmosphere, cos_sun)
    return (1.0 - a / _longest_sun_path(atmosphere)).clamp(min=0.0) / (1.0 + a)


def sun_from_unit(atmosphere: AtmosphereParameters, unit: Tensor) -> Tensor:
    """Cosine between sun and zenith of a place on the axis of the sun's height; inverse of `unit_from_sun`, shape `(...)`."""
    top, bottom, horizon = atmosphere.top_radius, atmosphere.bottom_radius, atmosphere.horizon_length
    largest = _longest_sun_path(atmosphere)
    a = (largest - unit * largest) / (1.0 + unit * largest)
    distance = atmosphere.thickness + a.clamp(max=largest) * (horizon - atmosphere.thickness)
    return clamp_cosine((atmosphere.thickness * (top + bottom) - distance.square()) / (2.0 * bottom * distance))


def unit_from_cosine(cosine: Tensor) -> Tensor:
    """Place on an axis that is linear in a cosine: (cosine + 1) / 2."""
    return 0.5 * (cosine + 1.0)


def cosine_from_unit(unit: Tensor) -> Tensor:
    """Cosine of a place on an axis that is linear in it; inverse of `unit_from_cosine`."""
    return clamp_cosine(2.0 * unit - 1.0)


def unit_from_altitude(atmosphere: AtmosphereParameters, radius: Tensor) -> Tensor:
    """Place on an axis that is linear in the radius [m]: 0 on the ground, 1 at the top."""
    return (radius - atmosphere.bottom_radius) / atmosphere.thickness


def altitude_from_unit(atmosphere: AtmosphereParameters, unit: Tensor) -> Tensor:
    """Radius [m] of a place on an axis that is linear in it; inverse of `unit_from_altitude`."""
    return atmosphere.bottom_radius + unit * atmosphere.thickness


def _sun_path(atmosphere: AtmosphereParameters, cos_sun: Tensor) -> Tensor:
    """The a of `unit_from_sun`: how far the way to the sun exceeds the vertical one, 1 for a horizontal one."""
    radius = torch.full_like(cos_sun, atmosphere.bottom_radius)
    distance = distance_to_top_boundary(atmosphere, radius, cos_sun)
    return (distance - atmosphere.thickness) / (atmosphere.horizon_length - atmosphere.thickness)


def _longest_sun_path(atmosphere: AtmosphereParameters) -> float:
    """The A of `unit_from_sun`."""
    return float(_sun_path(atmosphere, torch.tensor(atmosphere.min_cos_sun_zenith, dtype=torch.float64)))


def _or_one(value: Tensor) -> Tensor:
    """A divisor: the value where it is positive, 1 where the quotient is not used."""
    return torch.where(value > 0.0, value, 1.0)
