"""The air cut into concentric shells, and exact columns along rays: Gauss-Legendre in pieces where every density is smooth.

With s the distance along a ray from its point nearest to the centre, and p that smallest distance, r(s)^2 = p^2 + s^2. The ray crosses
the sphere of radius r_j at s = -+sqrt(r_j^2 - p^2). Between two crossings no profile has a kink and none changes by more than a small
factor, so that a few nodes integrate it to many digits in any direction: around the nearest point, too, r(s) is smooth.

A *column* is the integral of a relative density along a path [m]. Those of Rayleigh scatterers, aerosols and absorbers are kept apart
(`species`, in this order); with the extinctions of the three they give the optical depth at any number of wavelengths.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from render.atmosphere.parameters import AtmosphereParameters, DensityLayer, DensityProfile, evaluate_density
from render.atmosphere.ray_geometry import distance_to_top_boundary, horizon_cosine, sine_from_cosine
from render.atmosphere.transmittance import visible_sun_share

SCALE_HEIGHTS = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.5, 8.0, 10.0, 13.0, 17.0, 22.0, 30.0)
"""Altitudes that cut an exponential layer, in its scale heights; above the last is 1e-13 of its air."""

LEAST_SHELL = 1.0 / 256.0
"""Share of the thickness of the air below which a shell is not worth its nodes, unless a kink bounds it."""

LARGEST_SHELL = 1.0 / 6.0
"""Share of the thickness of the air above which a shell is cut in equal parts."""

ROUNDING = 1e-9
"""Share of the thickness of the air within which two kinks are one: where a layer ends and where it reaches zero."""

PIECE_NODES = 4
"""Gauss-Legendre nodes of a piece of a ray: columns to about 1e-8 of themselves."""


@dataclass(frozen=True, eq=False)
class Shells:
    """A planet's air, cut.

    Args:
        atmosphere: the planet.
        radii: of the spheres that bound the shells `(boundary,)`, from the ground to the top [m], float64.
        scattering: of the scattering species, Rayleigh and aerosols `(2, wavelength)` [1/m].
        extinction: of all species `(3, wavelength)` [1/m].
    """

    atmosphere: AtmosphereParameters
    radii: Tensor
    scattering: Tensor
    extinction: Tensor


def cut_into_shells(atmosphere: AtmosphereParameters) -> Shells:
    """Cut the air at the kinks of its profiles and at multiples of their scale heights."""
    thickness = atmosphere.thickness
    profiles = (atmosphere.rayleigh_density, atmosphere.mie_density, atmosphere.absorption_density)
    heights = [0.0, thickness]
    for height in sorted(h for profile in profiles for h in _kinks(profile) if 0.0 < h < thickness):
        if min(abs(height - other) for other in heights) > ROUNDING * thickness:
            heights.append(height)
    for height in sorted({h for profile in profiles for h in _scale_altitudes(profile) if h < thickness}):
        if min(abs(height - other) for other in heights) >= LEAST_SHELL * thickness:
            heights.append(height)
    heights.sort()
    cut = [0.0]
    for low, high in pairwise(heights):
        parts = math.ceil((high - low) / (LARGEST_SHELL * thickness))
        cut += [low + (high - low) * (part + 1) / parts for part in range(parts)]
    radii = atmosphere.bottom_radius + torch.tensor(cut, dtype=torch.float64)
    radii[-1] = atmosphere.top_radius
    scattering = [atmosphere.rayleigh_scattering, atmosphere.mie_scattering]
    extinction = [atmosphere.rayleigh_scattering, atmosphere.mie_extinction, atmosphere.absorption_extinction]
    return Shells(
        atmosphere, radii, torch.tensor(scattering, dtype=torch.float64), torch.tensor(extinction, dtype=torch.float64)
    )


def _layers(profile: DensityProfile) -> Iterator[tuple[float, DensityLayer]]:
    """Each layer with the altitude at which it begins [m]."""
    yield from zip((0.0, *profile.boundaries), profile.layers, strict=True)


def _kinks(profile: DensityProfile) -> Iterator[float]:
    """Altitudes at which the density, or its slope, jumps [m]: ends of layers, and where a straight one is clamped to 0 or 1."""
    for bottom, layer in _layers(profile):
        yield bottom
        if layer.linear_term and not layer.exp_term:
            yield from (
                h for h in ((level - layer.constant_term) / layer.linear_term for level in (0.0, 1.0)) if h > bottom
            )


def _scale_altitudes(profile: DensityProfile) -> Iterator[float]:
    """Altitudes at which an exponential layer has fallen by certain factors [m]."""
    for bottom, layer in _layers(profile):
        if layer.exp_term and layer.exp_scale:
            yield from (bottom + number / abs(layer.exp_scale) for number in SCALE_HEIGHTS)


@cache
def gauss_legendre(nodes: int) -> tuple[Tensor, Tensor]:
    """Abscissae in 0..1 and weights that sum to one, each `(nodes,)`, float64."""
    abscissa, weight = np.polynomial.legendre.leggauss(nodes)
    return torch.from_numpy(0.5 * (abscissa + 1.0)), torch.from_numpy(0.5 * weight)


def species_densities(atmosphere: AtmosphereParameters, altitude: Tensor) -> Tensor:
    """Relative densities of Rayleigh scatterers, aerosols and absorbers [1] at an altitude `(...)` [m], as `(..., 3)`."""
    profiles = (atmosphere.rayleigh_density, atmosphere.mie_density, atmosphere.absorption_density)
    return torch.stack([evaluate_density(profile, altitude) for profile in profiles], dim=-1)


def shell_crossings(shells: Shells, radius: Tensor, cosine: Tensor, distance: Tensor) -> Tensor:
    """Where rays pass from shell to shell.

    Args:
        shells: the air.
        radius: of the origins from the centre `(ray,)` [m].
        cosine: between ray and zenith there `(ray,)`.
        distance: to the end of each ray, within the air `(ray,)` [m].

    Returns:
        Distances along the rays `(ray, 2 boundary)` [m], not falling, from 0 to `distance`; a sphere that is not met gives a piece of
        no length.
    """
    impact = (radius * sine_from_cosine(cosine))[:, None]
    half = ((shells.radii - impact) * (shells.radii + impact)).clamp(min=0.0).sqrt()
    ahead = (radius * cosine)[:, None]
    there = torch.cat([-half.flip(-1), half], dim=-1) - ahead
    there = torch.minimum(there.clamp(min=0.0), distance[:, None])
    # The end may lie a rounding error off the last sphere.
    return torch.cat([torch.zeros_like(ahead), there[:, 1:-1], distance[:, None]], dim=-1)


def piece_columns(shells: Shells, radius: Tensor, cosine: Tensor, first: Tensor, last: Tensor) -> Tensor:
    """Columns of pieces of rays, each within one shell.

    Args:
        shells: the air.
        radius: of the origins from the centre, broadcast against `first` [m].
        cosine: between ray and zenith there, likewise.
        first, last: distances at which a piece begins and ends `(...)` [m].

    Returns:
        Columns `(..., species)` [m].
    """
    node, weight = gauss_legendre(PIECE_NODES)
    length = last - first
    along = first[..., None] + length[..., None] * node + (radius * cosine)[..., None]
    there = torch.hypot(along, (radius * sine_from_cosine(cosine))[..., None])
    density = species_densities(shells.atmosphere, there - shells.atmosphere.bottom_radius)
    return (density * weight[:, None]).sum(-2) * length[..., None]


def shell_columns(shells: Shells, radius: Tensor, cosine: Tensor, crossings: Tensor) -> Tensor:
    """Columns of the pieces of rays between their crossings.

    Args:
        shells: the air.
        radius: of the origins from the centre `(ray,)` [m].
        cosine: between ray and zenith there `(ray,)`.
        crossings: from `shell_crossings` `(ray, crossing)` [m].

    Returns:
        Columns `(ray, crossing - 1, species)` [m], zero for pieces of no length, which cost nothing.
    """
    first, last = crossings[:, :-1], crossings[:, 1:]
    columns = torch.zeros(*first.shape, 3, dtype=radius.dtype, device=radius.device)
    ray, piece = torch.nonzero(last > first, as_tuple=True)
    columns[ray, piece] = piece_columns(shells, radius[ray], cosine[ray], first[ray, piece], last[ray, piece])
    return columns


def compute_columns(shells: Shells, radius: Tensor, cosine: Tensor, distance: Tensor) -> Tensor:
    """Columns along rays, exact to about 1e-8 of themselves.

    Args:
        shells: the air.
        radius: of the origins from the centre `(...)` [m], float64.
        cosine: between ray and zenith there `(...)`.
        distance: to the end of each ray, within the air `(...)` [m].

    Returns:
        Columns `(..., species)` [m].
    """
    radius, cosine, distance = torch.broadcast_tensors(radius, cosine, distance)
    r, mu = radius.reshape(-1), cosine.reshape(-1)
    columns = shell_columns(shells, r, mu, shell_crossings(shells, r, mu, distance.reshape(-1))).sum(-2)
    return columns.reshape(*radius.shape, 3)


def compute_exact_transmittance(shells: Shells, radius: Tensor, cosine: Tensor, distance: Tensor) -> Tensor:
    """Transmittance of rays `(..., wavelength)` [1]; arguments as of `compute_columns`."""
    return torch.exp(-compute_columns(shells, radius, cosine, distance) @ shells.extinction)


def compute_exact_sun_transmittance(shells: Shells, radius: Tensor, cos_sun_zenith: Tensor) -> Tensor:
    """Share of the sun's light that reaches a point: transmittance towards its centre times the visible share of its disc.

    Towards a sun whose centre has set, the transmittance is that of the horizon.

    Args:
        shells: the air.
        radius: of the points from the centre `(...)` [m], float64.
        cos_sun_zenith: cosines between zenith and sun `(...)`.

    Returns:
        Shares `(..., wavelength)` [1].
    """
    planet = shells.atmosphere
    radius, cos_sun_zenith = torch.broadcast_tensors(radius, cos_sun_zenith)
    share = visible_sun_share(planet, radius, cos_sun_zenith)
    up = torch.nonzero(share.reshape(-1) > 0.0).flatten()
    r = radius.reshape(-1)[up]
    mu = torch.maximum(cos_sun_zenith.reshape(-1)[up], horizon_cosine(planet, r))
    found = compute_exact_transmittance(shells, r, mu, distance_to_top_boundary(planet, r, mu))
    light = torch.zeros(share.numel(), found.shape[-1], dtype=found.dtype, device=found.device)
    light[up] = found * share.reshape(-1)[up, None]
    return light.reshape(*share.shape, found.shape[-1])


def mean_incidence(atmosphere: AtmosphereParameters, cos_sun_zenith: Tensor) -> Tensor:
    """Mean over the sun's disc of the cosine with which its light falls on level ground: (mu_s + a)^2 / (4 a) while it rises.

    Args:
        atmosphere: the planet; a is the angular radius of its sun [rad].
        cos_sun_zenith: cosine between zenith and sun `(...)`.

    Returns:
        0 to 1 `(...)` [1].
    """
    a = atmosphere.sun_angular_radius
    rising = (cos_sun_zenith + a).clamp(min=0.0) ** 2 / (4.0 * a)
    return torch.where(cos_sun_zenith > a, cos_sun_zenith, rising)


def compute_exact_direct_irradiance(shells: Shells, cos_sun_zenith: Tensor) -> Tensor:
    """Irradiance of level ground by the sun itself.

    Args:
        shells: the air.
        cos_sun_zenith: cosines between zenith and sun `(...)`, float64.

    Returns:
        Irradiance `(..., wavelength)` [W/m^2/nm].
    """
    planet = shells.atmosphere
    solar = torch.tensor(planet.solar_irradiance, dtype=cos_sun_zenith.dtype)
    ground = torch.full_like(cos_sun_zenith, planet.bottom_radius)
    mu = cos_sun_zenith.clamp(min=0.0)
    transmittance = compute_exact_transmittance(shells, ground, mu, distance_to_top_boundary(planet, ground, mu))
    return solar * transmittance * mean_incidence(planet, cos_sun_zenith)[..., None]
