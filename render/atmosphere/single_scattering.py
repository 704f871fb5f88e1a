"""Light scattered once, converged: the truth that fast quadratures and tables are held to.

The integral along a ray is cut where the ray passes from shell to shell, and each piece is halved until an eight-point Gauss-Legendre
rule and its two halves agree: the edge of the planet's shadow, which may lie anywhere, is found by the halving.
"""

import torch
from torch import Tensor

from render.atmosphere.air_ray import AirRay
from render.atmosphere.rays import chosen_rays
from render.atmosphere.shells import (
    Shells,
    compute_columns,
    compute_exact_sun_transmittance,
    gauss_legendre,
    shell_crossings,
    species_densities,
)
from render.cornette_shanks import evaluate_cornette_shanks
from render.errors import ParameterError
from render.rayleigh_phase import evaluate_rayleigh_phase

RULE_NODES = 8
"""Gauss-Legendre nodes of a piece."""

MOST_HALVINGS = 24
"""A piece of 900 km is then 5 cm long, far less than the penumbra."""

PIECES_AT_ONCE = 512
"""Bounds the memory."""


def compute_single_scattering(shells: Shells, rays: AirRay, tolerance: float = 1e-6) -> tuple[Tensor, Tensor]:
    """Light scattered once on its way to the origins of rays, without the phase functions.

        E beta integral of density(t) T(origin, t) T(t, sun) dt

    E is the sun's irradiance, beta the scattering coefficient, T the transmittance.

    Args:
        shells: the air.
        rays: `(ray,)`, float64, to follow to the end of the air.
        tolerance: largest difference of a piece and its halves, relative to the whole integral.

    Returns:
        By air molecules and by aerosols, each `(ray, wavelength)` [W/m^2/nm].

    Raises:
        ParameterError: if the tolerance is not positive.
    """
    if not tolerance > 0.0:
        raise ParameterError(f"an integral converges to a positive tolerance, not {tolerance}")
    planet = shells.atmosphere
    at = shell_crossings(shells, rays.radius, rays.cos_view, rays.length(planet))
    ray, piece = torch.nonzero(at[:, 1:] > at[:, :-1], as_tuple=True)
    first, last = at[ray, piece], at[ray, piece + 1]
    value = _integrate(shells, rays, ray, first, last)
    coarse = torch.zeros(len(rays.radius), *value.shape[1:], dtype=torch.float64).index_add_(0, ray, value)
    total = torch.zeros_like(coarse)
    for _ in range(MOST_HALVINGS):
        middle = 0.5 * (first + last)
        near, far = _integrate(shells, rays, ray, first, middle), _integrate(shells, rays, ray, middle, last)
        open_ = ((near + far - value).abs() > tolerance * coarse[ray]).flatten(1).any(1)
        total.index_add_(0, ray[~open_], (near + far)[~open_])
        ray, first, last = (torch.cat(pair) for pair in ((ray, ray), (first, middle), (middle, last)))
        value = torch.cat([near, far])
        both = torch.cat([open_, open_])
        ray, first, last, value = ray[both], first[both], last[both], value[both]
        if len(ray) == 0:
            break
    total.index_add_(0, ray, value)
    light = total * shells.scattering * torch.tensor(planet.solar_irradiance, dtype=torch.float64)
    return light[:, 0], light[:, 1]


def compute_single_radiance(shells: Shells, rays: AirRay, tolerance: float = 1e-6) -> Tensor:
    """Radiance scattered once, with the phase functions `(ray, wavelength)` [W/m^2/sr/nm]; arguments as above."""
    molecules, aerosols = compute_single_scattering(shells, rays, tolerance)
    g = shells.atmosphere.mie_asymmetry
    rayleigh = evaluate_rayleigh_phase(rays.cos_view_sun)[:, None]
    return rayleigh * molecules + evaluate_cornette_shanks(rays.cos_view_sun, g)[:, None] * aerosols


def _integrate(shells: Shells, rays: AirRay, ray: Tensor, first: Tensor, last: Tensor) -> Tensor:
    """Integrals over pieces `(piece, 2, wavelength)` [m], some at a time."""
    wavelengths = shells.extinction.shape[-1]
    found = torch.empty(len(ray), 2, wavelengths, dtype=torch.float64)
    for start in range(0, len(ray), PIECES_AT_ONCE):
        some = slice(start, start + PIECES_AT_ONCE)
        found[some] = _integrate_chunk(shells, chosen_rays(rays, ray[some]), first[some], last[some])
    return found


def _integrate_chunk(shells: Shells, rays: AirRay, first: Tensor, last: Tensor) -> Tensor:
    node, weight = gauss_legendre(RULE_NODES)
    planet = shells.atmosphere
    length = last - first
    t = first[:, None] + length[:, None] * node
    here = rays.unsqueeze()
    there = here.at(planet, t)
    light = torch.exp(-compute_columns(shells, here.radius, here.cos_view, t) @ shells.extinction)
    light = light * compute_exact_sun_transmittance(shells, there.radius, there.cos_sun)
    density = species_densities(planet, there.radius - planet.bottom_radius)[..., :2] * (
        weight[:, None] * length[:, None, None]
    )
    return torch.einsum("pns,pnw->psw", density, light)
