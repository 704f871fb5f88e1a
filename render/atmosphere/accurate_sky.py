"""Sky radiance and aerial perspective by integrals along each ray: the accurate counterpart of looking them up in tables.

Light scattered once is integrated as it is, with the phase functions and the sunlight at every node; light scattered more often
comes from the source function. Nothing depends on the direction but through the ray, so the horizon is as sharp as it is.
"""

import torch
from torch import Tensor

from render.atmosphere.air_ray import AirRay
from render.atmosphere.ray_quadrature import RayNodes, place_nodes
from render.atmosphere.rays import chosen_rays
from render.atmosphere.shells import Shells
from render.atmosphere.sky import AirLight, check_vectors, enter_air, enter_air_towards
from render.atmosphere.source_function import SourceFunction, look_up_source
from render.atmosphere.sun_columns import SunColumns, look_up_sunlight
from render.cornette_shanks import evaluate_cornette_shanks
from render.rayleigh_phase import evaluate_rayleigh_phase

RAYS_AT_ONCE = 1 << 12
"""Bounds the memory."""


def compute_sky_radiance(source: SourceFunction, rays: AirRay) -> tuple[Tensor, Tensor]:
    """Light that the air sends along rays, and what it lets through.

    Args:
        source: of the planet.
        rays: `(ray,)`, float64.

    Returns:
        Radiance `(ray, wavelength)` [W/m^2/sr/nm], without that of the ground and the sun behind, and the transmittance to the end of
        the air `(ray, wavelength)` [1].
    """
    return compute_radiance_to_distance(source, rays, rays.length(source.atmosphere))


def compute_radiance_to_distance(source: SourceFunction, rays: AirRay, distance: Tensor) -> tuple[Tensor, Tensor]:
    """Light that the air in front of a point sends along a ray: aerial perspective.

    Args:
        source: of the planet.
        rays: `(ray,)`, float64.
        distance: to the points, within the air `(ray,)` [m].

    Returns:
        Radiance `(ray, wavelength)` [W/m^2/sr/nm] and transmittance `(ray, wavelength)` [1] up to the points.
    """
    wavelengths = source.shells.extinction.shape[-1]
    radiance = torch.empty(len(distance), wavelengths, dtype=torch.float64, device=distance.device)
    transmittance = torch.empty_like(radiance)
    for start in range(0, len(distance), RAYS_AT_ONCE):
        some = torch.arange(start, min(start + RAYS_AT_ONCE, len(distance)), device=distance.device)
        nodes = place_nodes(source.shells, chosen_rays(rays, some), distance[some], source.nodes)
        here = chosen_rays(rays, some)
        once = integrate_single_scattering(source.shells, source.sun_columns, here, nodes)
        radiance[some] = once + integrate_source(source.shells, source.source, here, nodes)
        transmittance[some] = nodes.transmittance_to_end
    return radiance, transmittance


def compute_sky_light(
    source: SourceFunction, camera: Tensor, view: Tensor, sun: Tensor, shadow_length: Tensor | float = 0.0
) -> AirLight:
    """Light of the air along rays that nothing but the ground stops; the accurate counterpart of `look_up_sky_radiance`.

    Args:
        source: of the planet.
        camera: eye points from the planet's centre `(..., 3)` [m]; may lie beyond the air.
        view: unit vectors of the rays `(..., 3)`.
        sun: unit vector towards the sun `(..., 3)`.
        shadow_length: of the part of the ray next to the camera that no sunlight reaches `(...)` [m].

    Returns:
        Radiance, and transmittance to the top of the air: 0 where the ray meets the ground, 1 where it misses the air.

    Raises:
        ParameterError: for other shapes, or numbers that are not finite.
    """
    camera, view, sun, shadow = check_vectors(camera, view, sun, shadow_length)
    rays, _, misses = enter_air(source.atmosphere, camera, view, sun)
    flat = _flattened(rays)
    shaded = torch.minimum(shadow.reshape(-1), flat.length(source.atmosphere))
    lit, beyond = compute_sky_radiance(source, flat.at(source.atmosphere, shaded))
    _, through = compute_radiance_to_distance(source, flat, shaded)
    clear = torch.where(flat.intersects_ground[:, None], 0.0, through * beyond)
    return _as_seen(misses, through * lit, clear)


def compute_light_to_point(
    source: SourceFunction, camera: Tensor, point: Tensor, sun: Tensor, shadow_length: Tensor | float = 0.0
) -> AirLight:
    """Light of the air between the camera and points; the accurate counterpart of `look_up_radiance_to_point`, never negative.

    Args:
        source: of the planet.
        camera: eye points from the planet's centre `(..., 3)` [m]; may lie beyond the air.
        point: what is looked at `(..., 3)` [m].
        sun: unit vector towards the sun `(..., 3)`.
        shadow_length: of the part of the ray next to the point that no sunlight reaches `(...)` [m].

    Returns:
        Radiance added and transmittance up to the point.

    Raises:
        ParameterError: for other shapes, numbers that are not finite, or a point that is the camera.
    """
    camera, point, sun, shadow = check_vectors(camera, point, sun, shadow_length, unit=False)
    rays, distance, misses = enter_air_towards(source.atmosphere, camera, point, sun)
    flat = _flattened(rays)
    inside = torch.minimum(distance.reshape(-1), flat.length(source.atmosphere))
    lit = (inside - shadow.reshape(-1)).clamp(min=0.0)
    radiance, _ = compute_radiance_to_distance(source, flat, lit)
    _, through = compute_radiance_to_distance(source, flat, inside)
    return _as_seen(misses, radiance, through)


def _flattened(rays: AirRay) -> AirRay:
    return AirRay(*(value.reshape(-1) for value in rays.expanded().tensors()))


def _as_seen(misses: Tensor, radiance: Tensor, transmittance: Tensor) -> AirLight:
    """Light in the shape of the rays `(...)`; rays that miss the air see none of it."""
    outside, shape = misses[..., None], (*misses.shape, radiance.shape[-1])
    return AirLight(
        torch.where(outside, 0.0, radiance.reshape(shape)), torch.where(outside, 1.0, transmittance.reshape(shape))
    )


def integrate_single_scattering(shells: Shells, sun_columns: SunColumns, rays: AirRay, nodes: RayNodes) -> Tensor:
    """Light scattered once along rays.

    Args:
        shells: the air.
        sun_columns: columns towards the sun.
        rays: `(ray,)`.
        nodes: along them.

    Returns:
        Radiance `(ray, wavelength)` [W/m^2/sr/nm].
    """
    once = integrate_sunlight(shells, sun_columns, rays, nodes)
    return (once * scattering_phases(shells.atmosphere.mie_asymmetry, rays.cos_view_sun)[..., None]).sum(-2)


def integrate_sunlight(shells: Shells, sun_columns: SunColumns, rays: AirRay, nodes: RayNodes) -> Tensor:
    """Light scattered once along rays, over the phase functions.

    Args:
        shells: the air.
        sun_columns: columns towards the sun.
        rays: `(ray,)`.
        nodes: along them.

    Returns:
        By molecules and aerosols `(ray, 2, wavelength)` [W/m^2/nm].
    """
    planet = shells.atmosphere
    there = rays.unsqueeze().at(planet, nodes.distance)
    light = look_up_sunlight(sun_columns, shells.extinction, there.radius, there.cos_sun)
    scattered = torch.einsum("rnsw,rnw->rsw", nodes.scattering_weights(shells), light)
    return scattered * torch.tensor(planet.solar_irradiance, dtype=light.dtype, device=light.device)


def integrate_source(shells: Shells, source: Tensor, rays: AirRay, nodes: RayNodes) -> Tensor:
    """Light of a table of sources along rays.

    Args:
        shells: the air.
        source: `(altitude, sun, angle, azimuth, 2 wavelength)` [W/m^2/sr/nm].
        rays: `(ray,)`.
        nodes: along them.

    Returns:
        Radiance `(ray, wavelength)` [W/m^2/sr/nm].
    """
    there = rays.unsqueeze().at(shells.atmosphere, nodes.distance)
    found = look_up_source(shells.atmosphere, source, there.radius, there.cos_view, there.cos_sun, there.cos_view_sun)
    return torch.einsum("rnsw,rnsw->rw", nodes.scattering_weights(shells), found.to(nodes.weight))


def scattering_phases(asymmetry: float, cosine: Tensor) -> Tensor:
    """Phase functions of molecules and aerosols `(..., 2)` [1/sr] at cosines `(...)`."""
    return torch.stack([evaluate_rayleigh_phase(cosine), evaluate_cornette_shanks(cosine, asymmetry)], dim=-1)
