"""How much light passes through the air: look-ups of the transmittance to the top, along a segment, and to the sun."""

import torch
from torch import Tensor

from render.atmosphere import table_mapping as mapping
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.ray_geometry import horizon_cosine, radius_along_ray, view_cosine_along_ray
from render.atmosphere.table_interpolation import interpolate_table


def look_up_transmittance_to_top(
    atmosphere: AtmosphereParameters, table: Tensor, radius: Tensor, cosine: Tensor
) -> Tensor:
    """Transmittance from a point to the top of the air.

    Args:
        atmosphere: the planet.
        table: `(radius, view, wavelength)` [1].
        radius: of the point from the centre `(...)` [m].
        cosine: between ray and zenith `(...)`; a ray below the horizon gets the value of the horizon.

    Returns:
        Transmittance `(..., wavelength)` [1].
    """
    radii, views, _ = table.shape
    places = (
        mapping.unit_from_radius(atmosphere, radius) * (radii - 1),
        mapping.unit_from_sky_view(atmosphere, radius, cosine) * (views - 1),
    )
    return interpolate_table(table, places)


def look_up_transmittance(
    atmosphere: AtmosphereParameters,
    table: Tensor,
    radius: Tensor,
    cosine: Tensor,
    distance: Tensor,
    intersects_ground: Tensor,
) -> Tensor:
    """Transmittance of a segment: the quotient of those to the top from its ends, at most 1.

    A ray that meets the ground is followed backwards, for the table knows only rays that reach the top. Where the transmittance to the top
    underflows to zero, nothing passes through the segment either.

    Args:
        atmosphere: the planet.
        table: `(radius, view, wavelength)` [1].
        radius: of the origin from the centre `(...)` [m].
        cosine: between ray and zenith `(...)`.
        distance: along the ray `(...)` [m].
        intersects_ground: whether the ray meets the ground `(...)`.

    Returns:
        Transmittance `(..., wavelength)` [1].
    """
    radius_there = radius_along_ray(atmosphere, radius, cosine, distance)
    cosine_there = view_cosine_along_ray(radius, cosine, distance, radius_there)
    sign = torch.where(intersects_ground, -1.0, 1.0).to(cosine.dtype)
    here = look_up_transmittance_to_top(atmosphere, table, radius, sign * cosine)
    there = look_up_transmittance_to_top(atmosphere, table, radius_there, sign * cosine_there)
    whole = torch.where(intersects_ground[..., None], there, here)
    beyond = torch.where(intersects_ground[..., None], here, there)
    return torch.where(beyond > 0.0, whole / torch.where(beyond > 0.0, beyond, 1.0), 0.0).clamp(max=1.0)


def visible_sun_share(atmosphere: AtmosphereParameters, radius: Tensor, cos_sun: Tensor) -> Tensor:
    """Share of the sun's disc above the horizon: a smooth step over the disc, seen at the angle to the horizon.

    Args:
        atmosphere: the planet.
        radius: of the point from the centre `(...)` [m].
        cos_sun: cosine between sun and zenith `(...)`.

    Returns:
        Share 0..1 `(...)`.
    """
    # The sun's centre is alpha away from the horizon where the cosine differs by alpha sin(angle of the horizon), sin = R / r.
    half_width = atmosphere.sun_angular_radius * atmosphere.bottom_radius / radius
    place = ((cos_sun - horizon_cosine(atmosphere, radius)) / (2.0 * half_width) + 0.5).clamp(0.0, 1.0)
    return place * place * (3.0 - 2.0 * place)


def look_up_transmittance_to_sun(
    atmosphere: AtmosphereParameters, table: Tensor, radius: Tensor, cos_sun: Tensor
) -> Tensor:
    """Transmittance from a point to the sun, none of it where the ground is in between.

    Args:
        atmosphere: the planet.
        table: `(radius, view, wavelength)` [1].
        radius: of the point from the centre `(...)` [m].
        cos_sun: cosine between sun and zenith `(...)`.

    Returns:
        Transmittance `(..., wavelength)` [1].
    """
    share = visible_sun_share(atmosphere, radius, cos_sun)[..., None]
    passing = look_up_transmittance_to_top(atmosphere, table, radius, cos_sun)
    return passing * share.to(passing.dtype)
