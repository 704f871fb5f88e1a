"""All that one camera sees of the air: a table over its directions of view, and its look-up.

A planet's air looks the same on both sides of the sun and jumps at the horizon, nowhere else. So the axes are the angle from the
horizon, on each side of it by itself, and the azimuth from the sun; nodes crowd at the horizon and on the sun's side. Light scattered
once is stored without the phase functions, for molecules and aerosols apart: these come in at the look-up, and with them all that is
sharp about the aureole. What is left is smooth.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.atmosphere.accurate_sky import scattering_phases
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.ray_geometry import horizon_distance
from render.atmosphere.sky import AirLight
from render.atmosphere.source_function import SourceFunction
from render.atmosphere.table_interpolation import interpolate_table
from render.errors import ParameterError

HORIZON_POWER, AZIMUTH_POWER = 3.0, 1.5
"""Angles from the horizon, and from the sun's azimuth, grow like these powers of the place on their axes."""

DIRECTIONS_AT_ONCE = 1 << 16
"""Bounds the memory of a look-up."""


@dataclass(frozen=True, eq=False)
class SkyView:
    """Light of the air in all directions from one point, under one sun.

    Args:
        source: of the planet.
        altitude: of the camera above the ground [m]; may lie beyond the air.
        sun: unit vector towards the sun `(3,)`, float64; z points to the zenith.
        light: `(2 elevation, azimuth, 3 wavelength)` [W/m^2/sr/nm]: elevations upwards from the horizon, then downwards from it; scattered
            once by molecules and once by aerosols, each over its phase function [W/m^2/nm], and more often.
        transmittance: to the end of the air, to the ground, or as far as the table reaches `(2 elevation, wavelength)` [1].

    Raises:
        ParameterError: if the shapes do not fit together, or the camera is below the ground.
    """

    source: SourceFunction
    altitude: float
    sun: Tensor
    light: Tensor
    transmittance: Tensor

    def __post_init__(self) -> None:
        check_altitude(self.altitude)
        wavelengths = self.source.shells.extinction.shape[-1]
        if (
            self.light.dim() != 3
            or self.light.shape[0] % 2
            or self.light.shape[2] != 3 * wavelengths
            or self.transmittance.shape != (self.light.shape[0], wavelengths)
        ):
            raise ParameterError(
                f"expected light (2 elevation, azimuth, {3 * wavelengths}) and as many transmittances, not "
                f"{tuple(self.light.shape)} and {tuple(self.transmittance.shape)}"
            )

    @property
    def atmosphere(self) -> AtmosphereParameters:
        """The planet."""
        return self.source.atmosphere

    @property
    def eye(self) -> Tensor:
        """The camera from the planet's centre `(3,)` [m]."""
        return torch.tensor([0.0, 0.0, self.atmosphere.bottom_radius + self.altitude], dtype=torch.float64)


def check_altitude(altitude: float) -> None:
    """Raise ParameterError for a camera below the ground, or nowhere."""
    if not (math.isfinite(altitude) and altitude >= 0.0):
        raise ParameterError(f"the camera must stand on the ground or above it, not at {altitude} m")


def horizon_angle(atmosphere: AtmosphereParameters, altitude: float) -> float:
    """Angle between the zenith and the horizon [rad], pi / 2 on the ground."""
    radius = torch.tensor(atmosphere.bottom_radius + altitude, dtype=torch.float64)
    return 0.5 * math.pi + math.atan2(float(horizon_distance(atmosphere, radius)), atmosphere.bottom_radius)


def angle_spans(atmosphere: AtmosphereParameters, altitude: float) -> tuple[float, float]:
    """Angles from the horizon up to the zenith, or to where rays pass the air by, and down to the nadir [rad]."""
    horizon, top = horizon_angle(atmosphere, altitude), atmosphere.top_radius
    radius = atmosphere.bottom_radius + altitude
    passes = math.pi - math.asin(top / radius) if radius > top else 0.0
    return horizon - passes, math.pi - horizon


def horizon_axis(count: int) -> Tensor:
    """Angles from the horizon of the nodes, as shares of their span `(elevation,)` [1], float64."""
    return torch.linspace(0.0, 1.0, count, dtype=torch.float64) ** HORIZON_POWER


def azimuth_axis(count: int) -> Tensor:
    """Azimuths from the sun of the nodes, 0 to pi `(azimuth,)` [rad], float64."""
    return math.pi * torch.linspace(0.0, 1.0, count, dtype=torch.float64) ** AZIMUTH_POWER


def look_up_sky_view(view: SkyView, direction: Tensor) -> tuple[AirLight, Tensor]:
    """Light of the air in directions.

    Args:
        view: of the camera.
        direction: unit vectors `(ray, 3)`, float64.

    Returns:
        Radiance and transmittance to the end of the air, or to the ground where that is in the way, and whether it is `(ray,)`.
    """
    parts = [_look_up(view, some) for some in direction.split(DIRECTIONS_AT_ONCE)]
    light = AirLight(torch.cat([part[0] for part in parts]), torch.cat([part[1] for part in parts]))
    return light, torch.cat([part[2] for part in parts])


def _look_up(view: SkyView, direction: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    elevations, azimuths = view.light.shape[0] // 2, view.light.shape[1]
    planet = view.atmosphere
    up, down = angle_spans(planet, view.altitude)
    level = torch.linalg.vector_norm(direction[:, :2], dim=-1)
    below = torch.atan2(level, direction[:, 2]) - horizon_angle(planet, view.altitude)
    ground = below > 0.0
    share = torch.where(ground, below / down, -below / up)
    misses = share > 1.0
    place = share.clamp(0.0, 1.0) ** (1.0 / HORIZON_POWER) * (elevations - 1)
    place = place + torch.where(ground, float(elevations), 0.0)
    turn = _azimuth_from_sun(direction, view.sun) / math.pi
    found = interpolate_table(view.light, (place, turn ** (1.0 / AZIMUTH_POWER) * (azimuths - 1)))
    molecules, aerosols, more = found.chunk(3, dim=-1)
    phases = scattering_phases(planet.mie_asymmetry, direction @ view.sun)
    radiance = molecules * phases[:, :1] + aerosols * phases[:, 1:] + more
    outside = (misses & ~ground)[:, None]
    passing = interpolate_table(view.transmittance, (place,))
    return torch.where(outside, 0.0, radiance), torch.where(outside, 1.0, passing), ground


def _azimuth_from_sun(direction: Tensor, sun: Tensor) -> Tensor:
    """Angle between the vertical planes of directions and sun `(ray,)` [rad], 0 to pi."""
    east, north = direction[:, 0], direction[:, 1]
    ahead = east * sun[0] + north * sun[1]
    return torch.atan2((east * sun[1] - north * sun[0]).abs(), ahead)
