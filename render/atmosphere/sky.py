"""What is seen and what is lit in an atmosphere: radiance of the sky, light added before a point, irradiance, the sun's disc.

These are the look-ups of Bruneton 2017. Positions are relative to the centre of the planet [m]. Radiance is spectral
[W/m^2/sr/nm]; `render/atmosphere/spectral_colour.py` turns it into colours.

Light shafts are known to the look-ups by a length alone: that of the part of the ray that lies in shadow.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.atmosphere.air_ray import AirRay
from render.atmosphere.parameters import AtmosphereParameters, spectrum_tensor
from render.atmosphere.ray_geometry import clamp_cosine, clamp_radius
from render.atmosphere.tables import AtmosphereTables, look_up_irradiance, look_up_scattering
from render.atmosphere.transmittance import (
    look_up_transmittance,
    look_up_transmittance_to_sun,
    look_up_transmittance_to_top,
)
from render.cornette_shanks import evaluate_cornette_shanks
from render.errors import ParameterError
from render.rayleigh_phase import evaluate_rayleigh_phase

AEROSOL_FADE = 0.01
"""Cosine between sun and zenith up to which light scattered once by aerosols is faded out before a point: there it is a small difference of
large interpolated numbers, and would show as bands at sunset. The reference does the same."""


@dataclass(frozen=True, eq=False)
class AirLight:
    """What the air does to a ray.

    Args:
        radiance: that it adds `(..., wavelength)` [W/m^2/sr/nm].
        transmittance: what it lets through `(..., wavelength)` [1].
    """

    radiance: Tensor
    transmittance: Tensor


@dataclass(frozen=True, eq=False)
class Irradiance:
    """Light that falls on a surface.

    Args:
        sun: directly `(..., wavelength)` [W/m^2/nm].
        sky: scattered `(..., wavelength)` [W/m^2/nm].
    """

    sun: Tensor
    sky: Tensor


def solar_radiance(atmosphere: AtmosphereParameters) -> Tensor:
    """Radiance of the sun's disc above the air `(wavelength,)` [W/m^2/sr/nm], float64: E / (pi alpha^2), the same all over it."""
    irradiance = torch.tensor(atmosphere.solar_irradiance, dtype=torch.float64)
    return irradiance / (math.pi * atmosphere.sun_angular_radius**2)


def look_up_sky_radiance(
    tables: AtmosphereTables, camera: Tensor, view: Tensor, sun: Tensor, shadow_length: Tensor | float = 0.0
) -> AirLight:
    """Light of the air along rays that nothing but the ground stops, without the sun's disc and without the ground's own light.

    Args:
        tables: of the atmosphere.
        camera: eye points from the planet's centre `(..., 3)` [m]; may lie beyond the air.
        view: unit vectors of the rays `(..., 3)`.
        sun: unit vector towards the sun `(..., 3)`.
        shadow_length: of the part of the ray next to the camera that no sunlight reaches `(...)` [m].

    Returns:
        Radiance, and transmittance to the top of the air: 0 where the ray meets the ground, 1 where it misses the air.

    Raises:
        ParameterError: for other shapes, or numbers that are not finite.
    """
    atmosphere = tables.atmosphere
    camera, view, sun, shadow = check_vectors(camera, view, sun, shadow_length)
    ray, _, misses = enter_air(atmosphere, camera, view, sun)
    here = look_up_transmittance_to_top(atmosphere, tables.transmittance, ray.radius, ray.cos_view)
    clear = torch.where(ray.intersects_ground[..., None], 0.0, here)
    air, aerosol = _scattered_separately(tables, ray.at(atmosphere, shadow))
    shaded = look_up_transmittance(
        atmosphere, tables.transmittance, ray.radius, ray.cos_view, shadow, ray.intersects_ground
    )
    shaded = torch.where((shadow > 0.0)[..., None], shaded, 1.0)
    radiance = _with_phases(atmosphere, ray, air * shaded, aerosol * shaded)
    outside = misses[..., None]
    return AirLight(torch.where(outside, 0.0, radiance), torch.where(outside, 1.0, clear))


def look_up_radiance_to_point(
    tables: AtmosphereTables, camera: Tensor, point: Tensor, sun: Tensor, shadow_length: Tensor | float = 0.0
) -> AirLight:
    """Light of the air between the camera and points, aerial perspective: light along the ray less what lies behind the point.

    Args:
        tables: of the atmosphere.
        camera: eye points from the planet's centre `(..., 3)` [m]; may lie beyond the air.
        point: what is looked at `(..., 3)` [m].
        sun: unit vector towards the sun `(..., 3)`.
        shadow_length: of the part of the ray next to the point that no sunlight reaches `(...)` [m].

    Returns:
        Radiance added and transmittance up to the point. Light is a difference of interpolated numbers, which for near points and a low sun
        may come out below zero; it is held at zero there.

    Raises:
        ParameterError: for other shapes, numbers that are not finite, or a point that is the camera.
    """
    atmosphere = tables.atmosphere
    camera, point, sun, shadow = check_vectors(camera, point, sun, shadow_length, unit=False)
    ray, distance, misses = enter_air_towards(atmosphere, camera, point, sun)
    passing = look_up_transmittance(
        atmosphere, tables.transmittance, ray.radius, ray.cos_view, distance, ray.intersects_ground
    )
    air, aerosol = _scattered_separately(tables, ray)
    lit = (distance - shadow).clamp(min=0.0)
    air_behind, aerosol_behind = _scattered_separately(tables, ray.at(atmosphere, lit))
    to_shadow = look_up_transmittance(
        atmosphere, tables.transmittance, ray.radius, ray.cos_view, lit, ray.intersects_ground
    )
    place = (ray.cos_sun / AEROSOL_FADE).clamp(0.0, 1.0)
    fade = (place * place * (3.0 - 2.0 * place))[..., None].to(air.dtype)
    radiance = _with_phases(
        atmosphere, ray, air - to_shadow * air_behind, (aerosol - to_shadow * aerosol_behind) * fade
    )
    outside = misses[..., None]
    return AirLight(torch.where(outside, 0.0, radiance.clamp(min=0.0)), torch.where(outside, 1.0, passing))


def look_up_surface_irradiance(tables: AtmosphereTables, point: Tensor, normal: Tensor, sun: Tensor) -> Irradiance:
    """Light that falls on a surface. That of the sky is the horizontal surface's, times (1 + normal . zenith) / 2.

    Args:
        tables: of the atmosphere.
        point: on the surface, from the planet's centre `(..., 3)` [m].
        normal: unit normal of the surface `(..., 3)`.
        sun: unit vector towards the sun `(..., 3)`.

    Returns:
        Irradiance by the sun and by the sky.

    Raises:
        ParameterError: for other shapes, or numbers that are not finite.
    """
    atmosphere = tables.atmosphere
    point, normal, sun, _ = check_vectors(point, normal, sun, 0.0)
    radius = torch.linalg.vector_norm(point, dim=-1)
    cos_sun = _dot(point, sun) / radius
    upright = (0.5 * (1.0 + _dot(normal, point) / radius))[..., None]
    sky = look_up_irradiance(atmosphere, tables.irradiance, radius, cos_sun)
    direct = look_up_transmittance_to_sun(atmosphere, tables.transmittance, radius, cos_sun)
    facing = _dot(normal, sun).clamp(min=0.0)[..., None].to(direct.dtype)
    solar = spectrum_tensor(atmosphere.solar_irradiance, direct)
    return Irradiance(direct * facing * solar, sky * upright.to(sky.dtype))


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1)


def check_vectors(
    first: Tensor, second: Tensor, sun: Tensor, shadow_length: Tensor | float, unit: bool = True
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Vectors and shadow lengths in float64, of the same shape; raises ParameterError for what is not one, as the look-ups say."""
    vectors = [torch.as_tensor(value, dtype=torch.float64) for value in (first, second, sun)]
    if any(value.shape[-1:] != (3,) for value in vectors):
        raise ParameterError(f"expected vectors (..., 3), got {', '.join(str(tuple(v.shape)) for v in vectors)}")
    shadow = torch.as_tensor(shadow_length, dtype=torch.float64, device=vectors[0].device)
    if not all(bool(torch.isfinite(value).all()) for value in (*vectors, shadow)):
        raise ParameterError("positions, directions and shadow lengths must be finite numbers")
    for value in vectors[1:] if unit else vectors[2:]:
        if bool(((torch.linalg.vector_norm(value, dim=-1) - 1.0).abs() > 1e-4).any()):
            raise ParameterError("directions must be unit vectors; divide them by their lengths")
    if bool((shadow < 0.0).any()):
        raise ParameterError("a shadow length cannot be negative")
    first, second, sun = torch.broadcast_tensors(*vectors)
    return first, second, sun, shadow.expand(first.shape[:-1])


def enter_air(
    atmosphere: AtmosphereParameters, camera: Tensor, view: Tensor, sun: Tensor
) -> tuple[AirRay, Tensor, Tensor]:
    """Rays from where they enter the air, the distance to there [m], and whether they miss it."""
    top = atmosphere.top_radius
    radius = torch.linalg.vector_norm(camera, dim=-1)
    along = _dot(camera, view)
    chord = along * along - radius * radius + top * top
    # The root of a negative number would be NaN, and every comparison with it false: said plainly instead.
    reaches = chord >= 0.0
    entry = -along - torch.where(reaches, chord, 0.0).sqrt()
    moved = reaches & (entry > 0.0)
    misses = ~moved & (radius > top)
    entry = torch.where(moved, entry, 0.0)
    eye = camera + entry[..., None] * view
    radius = torch.where(moved, top, clamp_radius(atmosphere, radius))
    along = along + entry
    cos_view, cos_sun = along / radius, _dot(eye, sun) / radius
    return (
        AirRay.towards(atmosphere, radius, clamp_cosine(cos_view), clamp_cosine(cos_sun), _dot(view, sun)),
        entry,
        misses,
    )


def enter_air_towards(
    atmosphere: AtmosphereParameters, camera: Tensor, point: Tensor, sun: Tensor
) -> tuple[AirRay, Tensor, Tensor]:
    """Rays to points from where they enter the air, the distance from there to the points [m], and whether no air lies between.

    Raises:
        ParameterError: for a point that is the camera.
    """
    offset = point - camera
    distance = torch.linalg.vector_norm(offset, dim=-1)
    if not bool((distance > 0.0).all()):
        raise ParameterError("a point that is looked at must lie apart from the camera; between them there is no air")
    ray, entry, misses = enter_air(atmosphere, camera, offset / distance[..., None], sun)
    return ray, (distance - entry).clamp(min=0.0), misses | (entry >= distance)


def _scattered_separately(tables: AtmosphereTables, ray: AirRay) -> tuple[Tensor, Tensor]:
    """Light scattered by all, over the Rayleigh phase function, and once by aerosols, over theirs."""
    return (
        look_up_scattering(tables.atmosphere, tables.scattering, ray),
        look_up_scattering(tables.atmosphere, tables.single_mie, ray),
    )


def _with_phases(atmosphere: AtmosphereParameters, ray: AirRay, air: Tensor, aerosol: Tensor) -> Tensor:
    rayleigh = evaluate_rayleigh_phase(ray.cos_view_sun)[..., None]
    mie = evaluate_cornette_shanks(ray.cos_view_sun, atmosphere.mie_asymmetry)[..., None]
    return air * rayleigh.to(air.dtype) + aerosol * mie.to(air.dtype)
