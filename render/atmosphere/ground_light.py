"""Light on the ground of a planet whose source function is known, and light that the ground sends back."""

import math

import torch
from torch import Tensor

from render.atmosphere.shells import Shells, mean_incidence
from render.atmosphere.sky import Irradiance
from render.atmosphere.source_function import SourceFunction, look_up_ground_sky_irradiance
from render.atmosphere.sun_columns import SunColumns, look_up_sun_columns


def look_up_ground_sunlight(shells: Shells, sun_columns: SunColumns, cos_sun: Tensor) -> Tensor:
    """Irradiance of level ground by the sun itself, of which some part may have set.

    Args:
        shells: the air.
        sun_columns: columns towards the sun.
        cos_sun: cosine between sun and zenith there `(...)`.

    Returns:
        Irradiance `(..., wavelength)` [W/m^2/nm].
    """
    planet = shells.atmosphere
    ground = torch.full_like(cos_sun, planet.bottom_radius)
    columns = look_up_sun_columns(sun_columns, ground, cos_sun.clamp(min=0.0))
    solar = torch.tensor(planet.solar_irradiance, dtype=torch.float64)
    return solar * torch.exp(-columns @ shells.extinction) * mean_incidence(planet, cos_sun)[..., None]


def look_up_ground_irradiance(source: SourceFunction, cos_sun: Tensor) -> Irradiance:
    """Light that falls on level ground.

    Args:
        source: of the planet.
        cos_sun: cosine between sun and zenith there `(...)`.

    Returns:
        Irradiance by the sun and by the sky, each `(..., wavelength)` [W/m^2/nm].
    """
    return Irradiance(
        look_up_ground_sunlight(source.shells, source.sun_columns, cos_sun),
        look_up_ground_sky_irradiance(source.sky_irradiance, cos_sun),
    )


def look_up_ground_radiance(source: SourceFunction, cos_sun: Tensor) -> Tensor:
    """Light of the ground itself, which reflects alike in all directions: albedo / pi times what falls on it.

    Args:
        source: of the planet.
        cos_sun: cosine between sun and zenith there `(...)`.

    Returns:
        Radiance `(..., wavelength)` [W/m^2/sr/nm], before any air between it and the eye.
    """
    lit = look_up_ground_irradiance(source, cos_sun)
    albedo = torch.tensor(source.atmosphere.ground_albedo, dtype=torch.float64)
    return albedo / math.pi * (lit.sun + lit.sky)
