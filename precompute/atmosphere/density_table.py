"""Fills the table of the scattering density: the sums of `compute_scattering_density`, regrouped so that directions cost little.

At a node of the table, radius and height of the sun are nodes as well. Along the directions of one polar angle the incident
light of a table is therefore a function of the cosine nu between direction and sun alone, linear between the table's nodes in
nu; so is the light from the ground, between the nodes of the irradiance. With x the place on the axis of nu, a function that is
linear between integers is

    f(x) = f_0 + s_0 x + sum over k of (s_k - s_{k-1}) (max(x, k) - k),   s_k = f_{k+1} - f_k.

The sums over azimuths of 1, x and max(x, k) times the phase functions are numbers that know nothing of the light; the light
enters once for each height of the sun and not for each direction. The result is that of the plain sum to rounding.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from precompute.atmosphere.quadratures import DirectionRule
from precompute.atmosphere.scattering_density import GroundReflection, ScatteredOrder, sun_direction
from render.atmosphere import table_mapping as mapping
from render.atmosphere.air_ray import AirRay
from render.atmosphere.parameters import AtmosphereParameters, evaluate_density, spectrum_tensor
from render.atmosphere.ray_geometry import ray_intersects_ground, sine_from_cosine
from render.atmosphere.table_interpolation import nearest_nodes
from render.atmosphere.tables import TableSizes, scattering_nodes, view_index
from render.cornette_shanks import evaluate_cornette_shanks
from render.rayleigh_phase import evaluate_rayleigh_phase

DIRECTIONS_AT_ONCE = 1 << 16
"""Pairs of a node and an azimuth that are worked on together for each table: half a megabyte a number, so that most of them stay in
the cache."""


def _coefficients(values: Tensor) -> Tensor:
    """Coefficients of 1, x and max(x, k), k = 1, 2, ..., of functions with values `(node, ...)` at x = 0, 1, 2, ..., same shape."""
    slopes = values.diff(dim=0)
    bends = slopes.diff(dim=0)
    place = torch.arange(1, len(values) - 1, dtype=values.dtype).reshape(-1, *(1,) * (values.dim() - 1))
    return torch.cat([values[:1] - (bends * place).sum(0), slopes[:1], bends])


@dataclass(frozen=True, eq=False)
class _Ring:
    """Incident light along the directions of one polar angle.

    Args:
        cosine, sine: of the angle to the zenith.
        weight: solid angle per azimuth [rad].
        tables: of the order before, as coefficients of functions of x `(term, table, sun, wavelength)`.
        ground: light from the ground, as coefficients of functions of y = `ground_offset` + `ground_slope` x
            `(term, 1, sun, wavelength)`; None where no ground is seen.
        ground_offset: `(sun,)`.
        ground_slope: how many nodes of the irradiance the ring spans per node in nu.
    """

    cosine: float
    sine: float
    weight: float
    tables: Tensor
    ground: Tensor | None
    ground_offset: Tensor
    ground_slope: float


def build_scattering_density(
    atmosphere: AtmosphereParameters,
    sizes: TableSizes,
    transmittance: Tensor,
    before: ScatteredOrder,
    ground_irradiance: Tensor,
    radius_node: int,
    rule: DirectionRule,
) -> Tensor:
    """Table of the scattering density at one radius.

    Args:
        atmosphere: the planet.
        sizes: nodes of each axis.
        transmittance: table `(radius, view, wavelength)` [1].
        before: light of the order before.
        ground_irradiance: table `(radius, sun, wavelength)` of the light that falls on the ground and belongs to that order [W/m^2/nm].
        radius_node: number of the radius.
        rule: of the integral.

    Returns:
        Source of the next order `(view, view_sun, sun, wavelength)` [W/m^3/sr/nm].
    """
    rays = scattering_nodes(atmosphere, sizes, radius_node)
    rings = [
        _incident_ring(atmosphere, transmittance, before, ground_irradiance, radius_node, rays, angle, weight)
        for angle, weight in zip(*rule.polar_nodes(math.pi), strict=True)
    ]
    directions = sizes.view_suns * sizes.suns * rule.azimuth_nodes()[0].shape[0]
    step = max(1, DIRECTIONS_AT_ONCE // (directions * len(before.tables)))
    found = [
        _scatter_rings(atmosphere, before, rings, _some_views(rays, slice(start, start + step)), rule)
        for start in range(0, sizes.views, step)
    ]
    by_air, by_aerosol = torch.cat(found).unbind(-2)
    altitude = rays.radius - atmosphere.bottom_radius
    return by_air * (
        evaluate_density(atmosphere.rayleigh_density, altitude).to(by_air.dtype)
        * spectrum_tensor(atmosphere.rayleigh_scattering, by_air)
    ) + by_aerosol * (
        evaluate_density(atmosphere.mie_density, altitude).to(by_air.dtype)
        * spectrum_tensor(atmosphere.mie_scattering, by_air)
    )


def _some_views(rays: AirRay, views: slice) -> AirRay:
    return AirRay(
        rays.radius, rays.cos_view[views], rays.cos_sun, rays.cos_view_sun[views], rays.intersects_ground[views]
    )


def _incident_ring(
    atmosphere: AtmosphereParameters,
    transmittance: Tensor,
    before: ScatteredOrder,
    irradiance: Tensor,
    radius_node: int,
    rays: AirRay,
    angle: Tensor,
    weight: Tensor,
) -> _Ring:
    """Incident light at one polar angle, for every height of the sun, as functions of the place on the axis of nu."""
    cosine = torch.cos(angle)
    views, view_suns = before.tables[0].shape[1:3]
    ring = AirRay(rays.radius, cosine, cosine, cosine, ray_intersects_ground(atmosphere, rays.radius, cosine))
    left, right = nearest_nodes(view_index(atmosphere, views, ring), views)
    above = right.to(before.tables[0].dtype)
    rows = [torch.lerp(table[radius_node, left], table[radius_node, left + 1], above) for table in before.tables]
    tables = _coefficients(torch.stack(rows, 1))
    ground, offset, slope = None, rays.cos_sun, 0.0
    if bool(ring.intersects_ground):
        reflection = GroundReflection.seen(atmosphere, transmittance, rays.radius, cosine)
        ground, offset, slope = _ground_ring(reflection, irradiance, rays.cos_sun, cosine, view_suns)
    return _Ring(float(cosine), float(torch.sin(angle)), float(weight), tables, ground, offset, slope)


def _ground_ring(
    reflection: GroundReflection, irradiance: Tensor, cos_sun: Tensor, cosine: Tensor, view_suns: int
) -> tuple[Tensor, Tensor, float]:
    """Light from the ground along a ring as a function of y, and what makes y of the place on the axis of nu.

    The cosine between sun and zenith on the ground is linear in nu; y is its place on the axis of the irradiance, counted from the
    lowest node that the ring needs.
    """
    count = irradiance.shape[1]
    zero = torch.zeros((), dtype=torch.float64)
    start, end = (
        mapping.unit_from_cosine((reflection.radius * cos_sun + reflection.distance * nu) / reflection.bottom_radius)
        * (count - 1)
        for nu in (zero - 1.0, zero + 1.0)
    )
    slope = float((end - start)[0]) / (view_suns - 1)
    spread = sine_from_cosine(cosine) * sine_from_cosine(cos_sun)
    reach = [start + (cosine * cos_sun + side + 1.0) * (0.5 * slope * (view_suns - 1)) for side in (-spread, spread)]
    lowest = reach[0].floor().clamp(0.0, count - 2.0)
    nodes = int((reach[1] - lowest).max().floor()) + 2
    index = (lowest.to(torch.int64) + torch.arange(nodes)[:, None]).clamp(max=count - 1)
    values = irradiance[0, index] * reflection.factor
    return _coefficients(values[:, None]), start - lowest, slope


def _scatter_rings(
    atmosphere: AtmosphereParameters, before: ScatteredOrder, rings: list[_Ring], rays: AirRay, rule: DirectionRule
) -> Tensor:
    """Incident light times both phase functions, over all directions `(view, view_sun, sun, 2, wavelength)`."""
    dtype, view_suns = before.tables[0].dtype, before.tables[0].shape[2]
    azimuth, share = (value[:, None] for value in rule.azimuth_nodes())
    half, suns = 0.5 * (view_suns - 1), rays.cos_sun.shape[-1]
    # Place on the axis of nu: half (1 + cos(theta) mu_s) + sin(theta) across. Azimuth before node, the order in which sums are fast.
    sun_x, sun_y = (value.flatten(1).unsqueeze(1) for value in sun_direction(rays))
    across = (half * (sun_x * torch.cos(azimuth) + sun_y * torch.sin(azimuth))).to(dtype)
    view, sine = rays.cos_view, sine_from_cosine(rays.cos_view)
    total = torch.zeros((), dtype=dtype)
    for ring in rings:
        turned = sine * ring.sine * torch.cos(azimuth) + view * ring.cosine
        phases = [evaluate_rayleigh_phase(turned), evaluate_cornette_shanks(turned, atmosphere.mie_asymmetry)]
        weights = (torch.cat(phases, -1) * (ring.weight * share)).to(dtype).transpose(1, 2).contiguous()
        offset = (half * (1.0 + ring.cosine * rays.cos_sun)).to(dtype).repeat(view_suns)
        x = torch.add(offset, across, alpha=ring.sine)
        total = total + _sum_azimuths(x, ring.tables, before.phase_factors(x / half - 1.0), weights)
        if ring.ground is not None:
            y = torch.add(ring.ground_offset.to(dtype).repeat(view_suns), x, alpha=ring.ground_slope)
            total = total + _sum_azimuths(y, ring.ground, (None,), weights)
    return (
        total.unflatten(1, (len(view), 2, view_suns))
        .permute(1, 3, 0, 2, 4)
        .reshape(-1, view_suns, suns, 2, total.shape[-1])
    )


def _sum_azimuths(x: Tensor, coefficients: Tensor, factors: tuple[Tensor | None, ...], weights: Tensor) -> Tensor:
    """Sum over azimuths of functions of the direction, given by their coefficients, times both phase functions.

    Args:
        x: place of each direction `(view, azimuth, node)`; a node is a pair of view_sun and sun.
        coefficients: `(term, table, sun, wavelength)`.
        factors: what each table is multiplied by `(view, azimuth, node)`, None for nothing.
        weights: phase functions times the weights of the directions `(view, 2, azimuth)`.

    Returns:
        `(sun, (view, 2, view_sun), wavelength)`.
    """
    suns = coefficients.shape[2]
    terms, product = [], torch.empty_like(x)
    for number in range(len(coefficients)):
        function = x if number < 2 else x.clamp(min=number - 1.0)
        for factor in factors:
            if number == 0:
                chosen = torch.ones_like(x) if factor is None else factor
            else:
                chosen = function if factor is None else torch.mul(function, factor, out=product)
            terms.append(torch.bmm(weights, chosen))
    sums = torch.stack(terms).reshape(len(terms), -1, suns).permute(2, 1, 0)
    return torch.bmm(sums, coefficients.flatten(0, 1).transpose(0, 1))
