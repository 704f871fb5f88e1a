"""Fill the source function order by order.

At each altitude of the table the radiance of one order is integrated along rays in a grid of directions: Gauss-Legendre in the cosine on
each side of the horizon, where it jumps, and equal steps in azimuth. Both phase functions are then applied to it in
spherical harmonics,

    S_species(direction) = sum over l, m of chi_l Y_lm(direction) [ sum over rays of weight Y_lm(ray) L(ray) ]

two matrix products, of which the harmonics of the table's directions belong to the sun's angle alone and those of the rays to
the altitude. A lobe that is cut at degree l loses chi_l^2 of the light next to the sun, for it has come through one lobe already.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from precompute.in_threads import map_in_threads
from render.atmosphere.accurate_sky import integrate_single_scattering
from render.atmosphere.air_ray import AirRay
from render.atmosphere.ground_light import look_up_ground_sunlight
from render.atmosphere.ray_geometry import clamp_cosine, distance_to_nearest_boundary, horizon_cosine, sine_from_cosine
from render.atmosphere.ray_quadrature import RayNodes, place_nodes
from render.atmosphere.shells import Shells, gauss_legendre
from render.atmosphere.source_function import (
    altitude_nodes,
    angle_nodes,
    azimuth_nodes,
    look_up_ground_sky_irradiance,
    look_up_source,
    sun_angle_nodes,
)
from render.atmosphere.sun_columns import SunColumns
from render.cornette_shanks import evaluate_cornette_shanks
from render.errors import ParameterError
from render.rayleigh_phase import evaluate_rayleigh_phase
from render.spherical_harmonics import (
    compute_phase_moments,
    degrees_of_harmonics,
    evaluate_even_harmonics,
)


@dataclass(frozen=True)
class SourceSizes:
    """How finely the source function is resolved.

    Args:
        altitudes, suns, angles, azimuths: nodes of the table's axes, at least 4 each.
        polar: directions of rays between zenith and horizon, and as many below.
        turns: their azimuths on one side of the sun.
        nodes: of each of the two legs of a ray.
        degree: of the spherical harmonics.

    Raises:
        ParameterError: for too few of anything, or a degree that the directions do not resolve.
    """

    altitudes: int = 16
    suns: int = 48
    angles: int = 25
    azimuths: int = 13
    polar: int = 14
    turns: int = 20
    nodes: int = 8
    degree: int = 24

    def __post_init__(self) -> None:
        if min(self.altitudes, self.suns, self.angles, self.azimuths, self.polar, self.turns, self.nodes) < 4:
            raise ParameterError(f"a source function needs at least 4 of everything, not {self}")
        if not 2 <= self.degree < 2 * self.turns:
            raise ParameterError(
                f"the degree must be at least 2, the Rayleigh function's, and less than twice the {self.turns} turns, not "
                f"{self.degree}"
            )

    @property
    def table(self) -> tuple[int, int, int, int]:
        """Nodes of the table."""
        return self.altitudes, self.suns, self.angles, self.azimuths

    @property
    def view_nodes(self) -> int:
        """Nodes of each leg of a ray of a camera: twice those of the table's own, whose errors the phase functions average."""
        return 2 * self.nodes

    def scaled(self, factor: float) -> "SourceSizes":
        """Sizes with this many times the intervals of each axis of the table and the directions and nodes of rays, at least 4."""

        def grow(count: int) -> int:
            return max(4, round(count * factor))

        altitudes, suns, angles, azimuths = (grow(count - 1) + 1 for count in self.table)
        turns = max(grow(self.turns), self.degree // 2 + 1)
        return SourceSizes(altitudes, suns, angles, azimuths, grow(self.polar), turns, grow(self.nodes), self.degree)


@dataclass(frozen=True, eq=False)
class OrderOfLight:
    """What one order adds.

    Args:
        order: number of scatterings and reflections, 2 for the first.
        source: that becomes light of this order `(altitude, sun, angle, azimuth, 2 wavelength)` [W/m^2/sr/nm], float32.
        sky_irradiance: of level ground by the order before `(sun, wavelength)` [W/m^2/nm].
    """

    order: int
    source: Tensor
    sky_irradiance: Tensor


@dataclass(frozen=True, eq=False)
class _Gatherer:
    """Everything that does not change from order to order."""

    shells: Shells
    sizes: SourceSizes
    sun_columns: SunColumns
    cos_sun: Tensor
    to_table: Tensor
    moments: Tensor

    @staticmethod
    def prepare(shells: Shells, sizes: SourceSizes, columns: SunColumns) -> "_Gatherer":
        cos_sun = torch.cos(sun_angle_nodes(sizes.suns))
        cosine, azimuth = _table_directions(sizes)
        harmonics = evaluate_even_harmonics(cosine, azimuth, sizes.degree)
        asymmetry = shells.atmosphere.mie_asymmetry
        chi = torch.stack(
            [
                compute_phase_moments(evaluate_rayleigh_phase, sizes.degree),
                compute_phase_moments(lambda c: evaluate_cornette_shanks(c, asymmetry), sizes.degree),
            ]
        )[:, degrees_of_harmonics(sizes.degree)]
        return _Gatherer(shells, sizes, columns, cos_sun, harmonics.float(), chi.float())


def _table_directions(sizes: SourceSizes) -> tuple[Tensor, Tensor]:
    """Cosine from the zenith and azimuth from the sun of the table's directions, each `(sun, angle * azimuth)`."""
    theta = sun_angle_nodes(sizes.suns)[:, None, None]
    angle, turn = angle_nodes(sizes.angles)[:, None], azimuth_nodes(sizes.azimuths)
    across = torch.sin(angle) * torch.cos(turn)
    up = torch.cos(angle) * torch.cos(theta) + across * torch.sin(theta)
    ahead = torch.cos(angle) * torch.sin(theta) - across * torch.cos(theta)
    side = (torch.sin(angle) * torch.sin(turn)).expand_as(up)
    return clamp_cosine(up).flatten(1), torch.atan2(side, ahead).flatten(1)


def compute_orders(shells: Shells, sizes: SourceSizes, sun_columns: SunColumns) -> Iterator[OrderOfLight]:
    """The orders of light from the second on, one after the other, without end.

    Args:
        shells: the air.
        sizes: how finely.
        sun_columns: columns towards the sun.

    Yields:
        What each order adds.
    """
    gatherer = _Gatherer.prepare(shells, sizes, sun_columns)
    before, order = None, 1
    while True:
        order += 1
        before = _next_order(gatherer, order, before)
        yield before


def _next_order(gatherer: _Gatherer, order: int, before: OrderOfLight | None) -> OrderOfLight:
    altitudes = altitude_nodes(gatherer.shells.atmosphere, gatherer.sizes.altitudes)
    levels = map_in_threads(lambda level: _gather_level(gatherer, altitudes[level], before), len(altitudes))
    return OrderOfLight(order, torch.stack([source for source, _ in levels]), levels[0][1])


def _gather_level(gatherer: _Gatherer, altitude: Tensor, before: OrderOfLight | None) -> tuple[Tensor, Tensor]:
    """Sources at one altitude `(sun, angle, azimuth, 2 wavelength)`, and the sky's irradiance there `(sun, wavelength)`."""
    sizes, planet = gatherer.sizes, gatherer.shells.atmosphere
    grid = _ray_grid(gatherer, planet.bottom_radius + altitude)
    radiance = _arriving_light(gatherer, grid, before)
    falling = (grid.weight * grid.rays.cos_view[:, 0, 0].clamp(min=0.0))[:, None, None, None]
    irradiance = 2.0 * (falling * radiance).sum((0, 2))
    source = _gather(gatherer, grid, radiance + _ground_light(gatherer, grid, before))
    return source.reshape(sizes.suns, sizes.angles, sizes.azimuths, -1), irradiance


@dataclass(frozen=True, eq=False)
class _Grid:
    """Rays from one altitude: broadcasting to `(polar, sun, turn)`, with their nodes `(polar, node)` and solid angles `(polar,)`."""

    rays: AirRay
    nodes: RayNodes
    length: Tensor
    weight: Tensor
    azimuth: Tensor


def _ray_grid(gatherer: _Gatherer, radius: Tensor) -> _Grid:
    sizes, planet = gatherer.sizes, gatherer.shells.atmosphere
    horizon = horizon_cosine(planet, radius)
    node, weight = gauss_legendre(sizes.polar)
    cosine = torch.cat([-1.0 + (horizon + 1.0) * node, horizon + (1.0 - horizon) * node])
    solid = torch.cat([(horizon + 1.0) * weight, (1.0 - horizon) * weight]) * (math.pi / sizes.turns)
    ground = torch.arange(2 * sizes.polar) < sizes.polar
    r = radius.expand_as(cosine)
    length = distance_to_nearest_boundary(planet, r, cosine, ground)
    flat = AirRay(r, cosine, cosine, cosine, ground)  # nodes do not ask where the sun is
    nodes = place_nodes(gatherer.shells, flat, length, sizes.nodes)
    azimuth = (torch.arange(sizes.turns, dtype=torch.float64) + 0.5) * (math.pi / sizes.turns)
    mu, mu_s = cosine[:, None, None], gatherer.cos_sun[None, :, None]
    nu = clamp_cosine(mu * mu_s + sine_from_cosine(mu) * sine_from_cosine(mu_s) * torch.cos(azimuth))
    rays = AirRay(r[:, None, None], mu, mu_s, nu, ground[:, None, None])
    return _Grid(rays, nodes, length, solid, azimuth)


def _arriving_light(gatherer: _Gatherer, grid: _Grid, before: OrderOfLight | None) -> Tensor:
    """Radiance scattered by the air as often as the order before `(polar, sun, turn, wavelength)` [W/m^2/sr/nm], float64."""
    return torch.stack([_light_of_polar(gatherer, grid, number, before) for number in range(len(grid.length))])


def _light_of_polar(gatherer: _Gatherer, grid: _Grid, number: int, before: OrderOfLight | None) -> Tensor:
    """Radiance of all suns and turns at one angle from the zenith `(sun, turn, wavelength)`."""
    shells, planet = gatherer.shells, gatherer.shells.atmosphere
    one = AirRay(*(value[number if len(value) > 1 else 0] for value in grid.rays.tensors()))
    if before is None:
        flat = AirRay(*(value.flatten() for value in one.expanded().tensors()))
        count = len(flat.radius)
        nodes = RayNodes(*(value[number].expand(count, *value[number].shape) for value in vars(grid.nodes).values()))
        light = integrate_single_scattering(shells, gatherer.sun_columns, flat, nodes)
        return light.reshape(*one.cos_view_sun.shape, -1)
    there = one.at(planet, grid.nodes.distance[number][:, None, None])
    found = look_up_source(planet, before.source, there.radius, there.cos_view, there.cos_sun, there.cos_view_sun)
    weight = grid.nodes.scattering_weights(shells)[number].to(found.dtype)
    return torch.einsum("ncw,nstcw->stw", weight, found).double()


def _ground_light(gatherer: _Gatherer, grid: _Grid, before: OrderOfLight | None) -> Tensor:
    """Radiance reflected by the ground as the last of these events `(polar, sun, turn, wavelength)` [W/m^2/sr/nm]."""
    planet = gatherer.shells.atmosphere
    albedo = torch.tensor(planet.ground_albedo, dtype=torch.float64)
    down = len(grid.length) // 2
    below = AirRay(*(value[:down] if len(value) > 1 else value for value in grid.rays.tensors()))
    cos_sun = below.at(planet, grid.length[:down, None, None]).cos_sun
    if before is None:
        irradiance = look_up_ground_sunlight(gatherer.shells, gatherer.sun_columns, cos_sun)
    else:
        irradiance = look_up_ground_sky_irradiance(before.sky_irradiance, cos_sun)
    through = grid.nodes.transmittance_to_end[:down, None, None]
    light = albedo / math.pi * through * irradiance
    return torch.cat([light, torch.zeros_like(light)])


def _gather(gatherer: _Gatherer, grid: _Grid, radiance: Tensor) -> Tensor:
    """Both phase functions applied to the light of the rays `(sun, direction, 2 wavelength)` [W/m^2/sr/nm], float32."""
    polar, suns, turns, wavelengths = radiance.shape
    harmonics = evaluate_even_harmonics(grid.rays.cos_view[:, :, 0], grid.azimuth, gatherer.sizes.degree).float()
    # Each ray stands for its mirror image, too, in which even harmonics are the same.
    weighted = (2.0 * grid.weight[:, None, None, None] * radiance).float()
    rays = weighted.permute(1, 3, 0, 2).reshape(suns * wavelengths, polar * turns)
    coefficients = (rays @ harmonics.reshape(polar * turns, -1)).reshape(suns, 1, wavelengths, -1)
    scattered = (coefficients * gatherer.moments[:, None]).reshape(suns, 2 * wavelengths, -1)
    return torch.einsum("sdk,swk->sdw", gatherer.to_table, scattered)
