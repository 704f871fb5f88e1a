"""Scattered light at every point of the air, gathered by the phase functions of what scatters it: the table of the accurate mode.

The *source* of a species is what its phase function p makes of the radiance L that arrives at a point,

    S(r, mu_s, w) = integral over w' of p(w . w') L(r, mu_s, w') dw'        [W/m^2/sr/nm]

and the light that is scattered towards a camera is the integral of (beta_R S_R + beta_M S_M) T along its ray. S is a smooth function
of everything, even at the ground and at the horizon: the phase functions have smoothed the directions, and the
densities, which change within a kilometre, are outside. So a coarse table does, and the horizon, the planet's shadow and the first
metre above the ground are left to the integral along the ray.

Axes: altitude by its cube root; the sun's angle from the zenith, crowded around the horizon; the angle between ray and sun, crowded at
the sun; and the azimuth around the sun, from the zenith. A table fixed to the sun keeps the aureole in its place while the sun moves.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.ray_geometry import clamp_cosine, sine_from_cosine
from render.atmosphere.shells import Shells
from render.atmosphere.sun_columns import SunColumns
from render.atmosphere.table_interpolation import interpolate_table
from render.errors import ParameterError

ALTITUDE_POWER, ANGLE_POWER = 3.0, 1.25
"""Altitude and angle to the sun grow like these powers of the place on their axes."""

SUN_CROWDING = 3.0
"""The sun's angle from the horizon grows like sinh of the place times this: nodes at the horizon are 3.3 times closer than on average."""


@dataclass(frozen=True, eq=False)
class SourceFunction:
    """Light scattered or reflected twice or more, and all that is needed to see it and the first order.

    Args:
        shells: the planet and its air.
        sun_columns: columns towards the sun.
        source: of orders 2 and up `(altitude, sun, angle, azimuth, 2 wavelength)` [W/m^2/sr/nm]: molecules at all wavelengths, then
            aerosols; entry n of the sum is what light of order n - 1 becomes by one more scattering.
        sky_irradiance: of level ground by scattered light of orders 1 to `orders` - 1 `(sun, wavelength)` [W/m^2/nm].
        orders: largest number of scatterings and reflections.
        nodes: of each leg of a camera's ray, along which the source is integrated.

    Raises:
        ParameterError: if the shapes do not fit together.
    """

    shells: Shells
    sun_columns: SunColumns
    source: Tensor
    sky_irradiance: Tensor
    orders: int
    nodes: int

    def __post_init__(self) -> None:
        wavelengths = self.shells.extinction.shape[-1]
        if self.source.dim() != 5 or self.source.shape[-1] != 2 * wavelengths:
            raise ParameterError(
                f"expected a source (altitude, sun, angle, azimuth, {2 * wavelengths}), not {tuple(self.source.shape)}"
            )
        if self.sky_irradiance.shape != (self.source.shape[1], wavelengths):
            raise ParameterError(
                f"expected the irradiance of {self.source.shape[1]} suns at {wavelengths} wavelengths, not "
                f"{tuple(self.sky_irradiance.shape)}"
            )

    @property
    def atmosphere(self) -> AtmosphereParameters:
        """The planet."""
        return self.shells.atmosphere


def _unit_nodes(count: int) -> Tensor:
    return torch.linspace(0.0, 1.0, count, dtype=torch.float64)


def altitude_nodes(atmosphere: AtmosphereParameters, count: int) -> Tensor:
    """Altitudes of the nodes `(altitude,)` [m], from the ground to the top."""
    return atmosphere.thickness * _unit_nodes(count) ** ALTITUDE_POWER


def place_of_altitude(atmosphere: AtmosphereParameters, altitude: Tensor, count: int) -> Tensor:
    """Place on the axis, in nodes `(...)`, of an altitude `(...)` [m]."""
    return (altitude / atmosphere.thickness).clamp(0.0, 1.0) ** (1.0 / ALTITUDE_POWER) * (count - 1)


def sun_angle_nodes(count: int) -> Tensor:
    """Angles between sun and zenith of the nodes `(sun,)` [rad], 0 to pi."""
    unit = 2.0 * _unit_nodes(count) - 1.0
    return 0.5 * math.pi * (1.0 + torch.sinh(SUN_CROWDING * unit) / math.sinh(SUN_CROWDING))


def place_of_sun(cos_sun: Tensor, count: int) -> Tensor:
    """Place on the axis, in nodes `(...)`, of a cosine between sun and zenith `(...)`."""
    below = torch.acos(clamp_cosine(cos_sun)) * (2.0 / math.pi) - 1.0
    return 0.5 * (torch.asinh(below * math.sinh(SUN_CROWDING)) / SUN_CROWDING + 1.0) * (count - 1)


def angle_nodes(count: int) -> Tensor:
    """Angles between ray and sun of the nodes `(angle,)` [rad], 0 to pi."""
    return math.pi * _unit_nodes(count) ** ANGLE_POWER


def place_of_angle(cos_view_sun: Tensor, count: int) -> Tensor:
    """Place on the axis, in nodes `(...)`, of a cosine between ray and sun `(...)`."""
    return (torch.acos(clamp_cosine(cos_view_sun)) / math.pi) ** (1.0 / ANGLE_POWER) * (count - 1)


def azimuth_nodes(count: int) -> Tensor:
    """Azimuths around the sun of the nodes `(azimuth,)` [rad]: 0 towards the zenith, pi away from it."""
    return math.pi * _unit_nodes(count)


def place_of_azimuth(cos_view: Tensor, cos_sun: Tensor, cos_view_sun: Tensor, count: int) -> Tensor:
    """Place on the axis, in nodes `(...)`, of a ray.

    By the spherical law of cosines, cos(azimuth) = (mu - nu mu_s) / (sin sin). Where the sun is in the zenith, or the ray points at
    it or away from it, the azimuth has no meaning and the source does not depend on it.

    Args:
        cos_view: mu, between ray and zenith `(...)`.
        cos_sun: mu_s, between sun and zenith `(...)`.
        cos_view_sun: nu, between ray and sun `(...)`.
        count: nodes of the axis.
    """
    sines = sine_from_cosine(cos_sun) * sine_from_cosine(cos_view_sun)
    cosine = (cos_view - cos_view_sun * cos_sun) / torch.where(sines > 0.0, sines, 1.0)
    return torch.acos(clamp_cosine(cosine)) / math.pi * (count - 1)


def look_up_source(
    atmosphere: AtmosphereParameters,
    source: Tensor,
    radius: Tensor,
    cos_view: Tensor,
    cos_sun: Tensor,
    cos_view_sun: Tensor,
) -> Tensor:
    """Interpolate a table of sources.

    Args:
        atmosphere: the planet.
        source: `(altitude, sun, angle, azimuth, 2 wavelength)` [W/m^2/sr/nm].
        radius: of the points from the centre `(...)` [m].
        cos_view, cos_sun, cos_view_sun: of a ray through each, as in `ray_geometry`; all broadcast.

    Returns:
        Sources `(..., 2, wavelength)` of molecules and aerosols [W/m^2/sr/nm].
    """
    altitudes, suns, angles, azimuths, columns = source.shape
    places = (
        place_of_altitude(atmosphere, radius - atmosphere.bottom_radius, altitudes),
        place_of_sun(cos_sun, suns),
        place_of_angle(cos_view_sun, angles),
        place_of_azimuth(cos_view, cos_sun, cos_view_sun, azimuths),
    )
    found = interpolate_table(source, places)
    return found.reshape(*found.shape[:-1], 2, columns // 2)


def look_up_ground_sky_irradiance(table: Tensor, cos_sun: Tensor) -> Tensor:
    """Irradiance of level ground by the sky.

    Args:
        table: `(sun, wavelength)` [W/m^2/nm].
        cos_sun: cosine between sun and zenith there `(...)`.

    Returns:
        Irradiance `(..., wavelength)` [W/m^2/nm].
    """
    return interpolate_table(table, (place_of_sun(cos_sun, table.shape[0]),))
