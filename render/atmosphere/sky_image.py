"""Pictures of the sky: the air's light, the ground below it and the sun's disc along the rays of a camera, and how they are shown.

World axes: x east, y north, z up at the camera. The ground is a sphere of even albedo that reflects alike in all directions.
"""

import math

import torch
from torch import Tensor

from render.atmosphere.ground_light import look_up_ground_radiance
from render.atmosphere.parameters import AtmosphereParameters, spectrum_tensor
from render.atmosphere.ray_geometry import distance_to_bottom_boundary, ray_intersects_ground
from render.atmosphere.sky import look_up_sky_radiance, look_up_surface_irradiance, solar_radiance
from render.atmosphere.sky_view import SkyView, check_altitude, look_up_sky_view
from render.atmosphere.spectral_colour import convert_to_linear_srgb
from render.atmosphere.tables import AtmosphereTables
from render.atmosphere.transmittance import look_up_transmittance
from render.colour import luminance
from render.errors import ParameterError

SHOWN_WHITE = 0.9
"""Share of the pixels that are darker than the luminance which automatic exposure takes for white."""


def compose_sky(tables: AtmosphereTables, altitude: float, direction: Tensor, sun: Tensor) -> Tensor:
    """Radiance that arrives at a camera: air, ground and the sun's disc.

    Args:
        tables: of the atmosphere.
        altitude: of the camera above the ground [m]; may lie beyond the air.
        direction: unit vectors of the rays `(ray, 3)`.
        sun: unit vector towards the sun `(3,)`.

    Returns:
        Radiance `(ray, wavelength)` [W/m^2/sr/nm].

    Raises:
        ParameterError: if the altitude is negative or not finite, or the directions are none.
    """
    check_altitude(altitude)
    atmosphere = tables.atmosphere
    direction, sun = (torch.nn.functional.normalize(value.double(), dim=-1) for value in (direction, sun))
    eye = direction.new_tensor([0.0, 0.0, atmosphere.bottom_radius + altitude])
    seen = look_up_sky_radiance(tables, eye, direction, sun)
    return (
        seen.radiance
        + _disc_radiance(atmosphere, direction, sun, seen.transmittance)
        + _ground_radiance(tables, eye, direction, sun)
    )


def compose_sky_view(view: SkyView, direction: Tensor) -> Tensor:
    """Radiance that arrives at a camera, as by `compose_sky`, from what it sees of the air.

    Args:
        view: of the camera, under its sun.
        direction: unit vectors of the rays `(ray, 3)`.

    Returns:
        Radiance `(ray, wavelength)` [W/m^2/sr/nm].
    """
    planet = view.atmosphere
    direction = torch.nn.functional.normalize(direction.double(), dim=-1)
    seen, ground = look_up_sky_view(view, direction)
    clear = torch.where(ground[:, None], 0.0, seen.transmittance)
    radiance = seen.radiance + _disc_radiance(planet, direction, view.sun, clear)
    if bool(ground.any()):
        down = direction[ground]
        distance = distance_to_bottom_boundary(planet, torch.linalg.vector_norm(view.eye), down[:, 2])
        normal = torch.nn.functional.normalize(view.eye + distance[:, None] * down, dim=-1)
        radiance[ground] += seen.transmittance[ground] * look_up_ground_radiance(view.source, normal @ view.sun)
    return radiance


def _disc_radiance(atmosphere: AtmosphereParameters, direction: Tensor, sun: Tensor, transmittance: Tensor) -> Tensor:
    """Light of the sun's disc that reaches the eye `(ray, wavelength)` [W/m^2/sr/nm], zero beside it."""
    disc = (direction @ sun >= math.cos(atmosphere.sun_angular_radius))[:, None]
    return torch.where(disc, transmittance * solar_radiance(atmosphere).to(transmittance), 0.0)


def _ground_radiance(tables: AtmosphereTables, eye: Tensor, direction: Tensor, sun: Tensor) -> Tensor:
    """Light of the ground that reaches the eye `(ray, wavelength)` [W/m^2/sr/nm], zero along rays that do not meet it."""
    atmosphere = tables.atmosphere
    light = torch.zeros(len(direction), len(atmosphere.wavelengths), dtype=tables.scattering.dtype)
    radius = torch.linalg.vector_norm(eye)
    down = ray_intersects_ground(atmosphere, radius, direction[:, 2])
    if not bool(down.any()):
        return light
    direction = direction[down]
    distance = distance_to_bottom_boundary(atmosphere, radius, direction[:, 2])
    point = eye + distance[:, None] * direction
    normal = torch.nn.functional.normalize(point, dim=-1)
    lit = look_up_surface_irradiance(tables, point, normal, sun)
    # From the ground back to the eye, or to where the ray leaves the air on its way there.
    up = -(direction * normal).sum(-1)
    ground = torch.full_like(up, atmosphere.bottom_radius)
    passing = look_up_transmittance(
        atmosphere, tables.transmittance, ground, up, distance, torch.zeros_like(up, dtype=torch.bool)
    )
    reflected = spectrum_tensor(atmosphere.ground_albedo, light) / math.pi
    light[down] = (lit.sun + lit.sky) * reflected * passing
    return light


def panorama_directions(width: int, height: int) -> Tensor:
    """Directions `(pixel, 3)` of an image of all around: azimuth from north over east to north, elevation from zenith to nadir."""
    azimuth = (torch.arange(width, dtype=torch.float64) + 0.5) / width * (2.0 * math.pi)
    elevation = (0.5 - (torch.arange(height, dtype=torch.float64) + 0.5) / height) * math.pi
    level = torch.cos(elevation)[:, None]
    parts = (level * torch.sin(azimuth), level * torch.cos(azimuth), torch.sin(elevation)[:, None].expand(-1, width))
    return torch.stack(parts, -1).reshape(-1, 3)


def colour_sky(atmosphere: AtmosphereParameters, radiance: Tensor) -> Tensor:
    """Linear sRGB `(..., channel)` [cd/m^2] of radiance `(..., wavelength)` [W/m^2/sr/nm], saturated colours held at zero."""
    return convert_to_linear_srgb(radiance, atmosphere.wavelengths).clamp(min=0.0)


def choose_white(rgb: Tensor) -> float:
    """Luminance [cd/m^2] that a picture `(..., channel)` [cd/m^2] needs for white: a tenth of its pixels is brighter. 1 for a black one."""
    values = luminance(rgb).flatten()
    chosen = float(values.kthvalue(max(1, math.ceil(SHOWN_WHITE * values.numel()))).values)
    return chosen if chosen > 0.0 else 1.0


def show_sky(rgb: Tensor, white: float, exposure: float = 0.0) -> Tensor:
    """A picture for a display: 1 - exp(-L / white), so that nothing burns out at once.

    Args:
        rgb: linear sRGB `(..., channel)` [cd/m^2].
        white: luminance that is shown as 0.63, which the display curve makes a light grey [cd/m^2].
        exposure: brighter by so many factors of two [1].

    Returns:
        Linear light `(..., channel)` [1], float32; display white is 1.

    Raises:
        ParameterError: if the white is not positive, or the exposure is not finite.
    """
    if not (white > 0.0 and math.isfinite(white) and math.isfinite(exposure)):
        raise ParameterError(f"expected a positive white and a finite exposure, got {white} cd/m^2 and {exposure}")
    return -torch.expm1(-rgb * (2.0**exposure / white)).to(torch.float32)
