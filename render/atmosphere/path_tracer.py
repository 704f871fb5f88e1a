"""Monte Carlo truth of an atmosphere: backward paths in the spherical shell, order by order, with standard errors.

A path starts at the camera. Each event on it, a scattering in the air or a reflection by the ground, is connected to the sun: event k
is the order k of the light that the camera sees. The ground that the camera sees directly is no event, for the light that leaves
it is not that of the sky.

Flights end where `free_flight` puts them, always in the air where the ray leads into space or is the camera's own. One wavelength, its
*hero*, chooses the steps of a path; the path stands for all of them with the balance heuristic over the heroes
(Wilkie et al. 2014, "Hero wavelength spectral sampling"):

    weight(w) = prod f_w / mean over heroes v of prod q_v

f is what a step contributes, q the density with which it was drawn. Transmittances, the sun's too, are integrals that are exact to
1e-8, so nothing but the noise separates the means from the truth.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.atmosphere.free_flight import Weights, fly
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.rays import rays_from_vectors
from render.atmosphere.shells import (
    Shells,
    compute_exact_direct_irradiance,
    compute_exact_sun_transmittance,
    cut_into_shells,
    species_densities,
)
from render.cornette_shanks import evaluate_cornette_shanks, sample_cornette_shanks_cosine
from render.errors import ParameterError
from render.phase_functions import evaluate_phase_function, rotate_direction, sample_phase_cosine
from render.random_streams import counter_keys, counter_uniform, stream_number
from render.rayleigh_phase import evaluate_rayleigh_phase, sample_rayleigh_cosine

LANES = 1 << 12
"""Paths in flight at once; bounds the memory."""

PATHS_PER_RAY = 1 << 32
"""Numbers that the paths of a ray may have."""

SUN_SHARE, SUN_ASYMMETRY = 0.1, 0.7
"""Share of directions drawn from a Henyey-Greenstein lobe around the sun, whose aureole is bright, and its asymmetry."""

DRAWS_PER_EVENT = 4
"""Random numbers of one event: flight, species or lobe, cosine, azimuth. The hero is one more, the first of a path."""


@dataclass(frozen=True, eq=False)
class AtmosphereReference:
    """Monte Carlo estimate of the light that reaches the origins of rays.

    Args:
        orders: mean radiance by number of events `(ray, wavelength, order)` [W/m^2/sr/nm], float64; entry 0 is single scattering.
        orders_error: standard error of each mean, same shape and unit.
        radiance: sum of the orders `(ray, wavelength)` [W/m^2/sr/nm].
        radiance_error: its standard error, with the correlation of the orders.
        paths: of each ray.
    """

    orders: Tensor
    orders_error: Tensor
    radiance: Tensor
    radiance_error: Tensor
    paths: int


def trace_atmosphere(
    atmosphere: AtmosphereParameters,
    position: Tensor,
    direction: Tensor,
    sun: Tensor,
    *,
    orders: int,
    paths: int,
    seed: int = 0,
) -> AtmosphereReference:
    """Path trace rays that start within the air.

    Args:
        atmosphere: the planet.
        position: origins of the rays relative to the planet's centre `(ray, 3)` [m].
        direction: unit vectors `(ray, 3)`.
        sun: unit vectors towards the sun `(ray, 3)`, or one for all `(3,)`.
        orders: largest number of events of a path.
        paths: of each ray, at least two.
        seed: of the random streams; a path's numbers depend on it, its ray and its own number only.

    Returns:
        Means and standard errors.

    Raises:
        ParameterError: for fewer than two paths, no order, or an origin outside the air.
    """
    if orders < 1 or paths < 2:
        raise ParameterError(f"a reference needs at least one order and two paths, not {orders} and {paths}")
    position, direction, sun = torch.broadcast_tensors(position.double(), direction.double(), sun.double())
    rays_from_vectors(atmosphere, position, direction, sun)
    shells = cut_into_shells(atmosphere)
    rays, wavelengths = len(position), len(atmosphere.wavelengths)
    sums = torch.zeros(2, rays, wavelengths, orders + 1, dtype=torch.float64)
    stream = stream_number(seed)
    for first in range(0, rays * paths, LANES):
        path = torch.arange(first, min(first + LANES, rays * paths))
        ray = path // paths
        keys = counter_keys(stream, ray * PATHS_PER_RAY + path % paths)
        value = _trace(shells, position[ray], direction[ray], sun[ray], orders, keys)
        value = torch.cat([value, value.sum(-1, keepdim=True)], dim=-1)
        sums[0].index_add_(0, ray, value)
        sums[1].index_add_(0, ray, value * value)
    mean = sums[0] / paths
    error = ((sums[1] / paths - mean * mean).clamp(min=0.0) / (paths - 1)).sqrt()
    return AtmosphereReference(mean[..., :-1], error[..., :-1], mean[..., -1], error[..., -1], paths)


@dataclass(frozen=True, eq=False)
class _Paths:
    """Where paths are, whereto they go, their heroes, weights and keys of random numbers; `(lane, ...)`."""

    lane: Tensor
    position: Tensor
    direction: Tensor
    sun: Tensor
    hero: Tensor
    weights: Weights
    keys: Tensor

    def __getitem__(self, chosen: Tensor) -> "_Paths":
        return _Paths(
            self.lane[chosen],
            self.position[chosen],
            self.direction[chosen],
            self.sun[chosen],
            self.hero[chosen],
            self.weights[chosen],
            self.keys[chosen],
        )


def _trace(shells: Shells, position: Tensor, direction: Tensor, sun: Tensor, orders: int, keys: Tensor) -> Tensor:
    """Contributions of one batch of paths `(lane, wavelength, order)`."""
    lanes, wavelengths = len(position), shells.extinction.shape[-1]
    value = torch.zeros(lanes, wavelengths, orders, dtype=torch.float64)
    hero = (counter_uniform(keys, 0) * wavelengths).long()
    weights = Weights.ones(lanes, wavelengths)
    paths = _Paths(torch.arange(lanes), position, direction, sun, hero, weights, keys)
    for order in range(orders):
        draws = [_uniform(paths.keys, 1 + order * DRAWS_PER_EVENT + number) for number in range(DRAWS_PER_EVENT)]
        paths, on_ground, alive = _move(shells, paths, draws[0], order == 0)
        draws = [draw[alive] for draw in draws[1:]]
        following = []
        for place, scatter in ((~on_ground, _scatter), (on_ground, _reflect)):
            light, scattered = scatter(shells, paths[place], [draw[place] for draw in draws])
            value[scattered.lane, :, order] = light
            following.append(scattered)
        paths = _join(*following)
        if len(paths.lane) == 0:
            break
    return value


def _uniform(keys: Tensor, dimension: int) -> Tensor:
    return counter_uniform(keys, dimension).double()


def _join(some: _Paths, others: _Paths) -> _Paths:
    def both(name: str) -> Tensor:
        return torch.cat([getattr(some, name), getattr(others, name)])

    weights = some.weights.joined(others.weights)
    return _Paths(both("lane"), both("position"), both("direction"), both("sun"), both("hero"), weights, both("keys"))


def _move(shells: Shells, paths: _Paths, draw: Tensor, camera: bool) -> tuple[_Paths, Tensor, Tensor]:
    """One flight: the paths that go on, at their events; which of these are on the ground; and which of all went on."""
    rays = rays_from_vectors(shells.atmosphere, paths.position, paths.direction, paths.sun)
    forced = torch.full_like(rays.intersects_ground, camera)
    distance, on_ground, alive, weights = fly(shells, rays, forced, paths.hero, paths.weights, draw)
    position = paths.position + distance[:, None] * paths.direction
    radius = torch.linalg.vector_norm(position, dim=-1)
    bottom, top = shells.atmosphere.bottom_radius, shells.atmosphere.top_radius
    kept = torch.where(on_ground, bottom, radius.clamp(bottom, top))
    position = position * (kept / radius)[:, None]
    moved = _Paths(paths.lane, position, paths.direction, paths.sun, paths.hero, weights, paths.keys)
    return moved[alive], on_ground[alive], alive


def _scatter(shells: Shells, paths: _Paths, draws: list[Tensor]) -> tuple[Tensor, _Paths]:
    """Light of the sun that events in the air send along the paths `(lane, wavelength)`, and the paths in new directions."""
    planet = shells.atmosphere
    radius = torch.linalg.vector_norm(paths.position, dim=-1)
    altitude = radius - planet.bottom_radius
    scattering = species_densities(planet, altitude)[:, :2, None] * shells.scattering
    to_sun = compute_exact_sun_transmittance(shells, radius, (paths.position * paths.sun).sum(-1) / radius)
    solar = torch.tensor(planet.solar_irradiance, dtype=torch.float64)
    phase = _phases(planet, (paths.direction * paths.sun).sum(-1))
    light = paths.weights.estimate() * (phase[..., None] * scattering).sum(1) * to_sun * solar

    total = scattering.sum(1, keepdim=True)
    share = torch.where(total > 0.0, scattering / torch.where(total > 0.0, total, 1.0), 0.5)
    of_hero = share[torch.arange(len(radius)), 0, paths.hero]
    direction = _turn(planet, paths, of_hero, draws)
    phase = _phases(planet, (paths.direction * direction).sum(-1))[..., None]
    lobe = evaluate_phase_function((direction * paths.sun).sum(-1), SUN_ASYMMETRY)
    density = (1.0 - SUN_SHARE) * (phase * share).sum(1) + SUN_SHARE * lobe[:, None]
    weights = paths.weights.times((phase * scattering).sum(1), density)
    return light, _Paths(paths.lane, paths.position, direction, paths.sun, paths.hero, weights, paths.keys)


def _phases(planet: AtmosphereParameters, cosine: Tensor) -> Tensor:
    """Phase functions of molecules and aerosols `(lane, 2)` [1/sr]."""
    cosine = cosine.clamp(-1.0, 1.0)
    return torch.stack([evaluate_rayleigh_phase(cosine), evaluate_cornette_shanks(cosine, planet.mie_asymmetry)], -1)


def _turn(planet: AtmosphereParameters, paths: _Paths, rayleigh_share: Tensor, draws: list[Tensor]) -> Tensor:
    """Directions from the lobe around the sun, or from the phase function of a species."""
    choice, uniform, azimuth = draws
    by_sun = choice < SUN_SHARE
    by_air = ~by_sun & ((choice - SUN_SHARE) < (1.0 - SUN_SHARE) * rayleigh_share)
    asymmetry = torch.full_like(uniform, SUN_ASYMMETRY)
    cosine = sample_cornette_shanks_cosine(planet.mie_asymmetry, uniform)
    cosine = torch.where(by_air, sample_rayleigh_cosine(uniform), cosine)
    cosine = torch.where(by_sun, sample_phase_cosine(asymmetry, uniform), cosine)
    axis = torch.where(by_sun[:, None], paths.sun, paths.direction)
    return rotate_direction(axis, cosine, 2.0 * math.pi * azimuth)


def _reflect(shells: Shells, paths: _Paths, draws: list[Tensor]) -> tuple[Tensor, _Paths]:
    """Light of the sun that the ground sends along the paths `(lane, wavelength)`, and the paths in directions after the cosine."""
    planet = shells.atmosphere
    albedo = torch.tensor(planet.ground_albedo, dtype=torch.float64)
    zenith = paths.position / torch.linalg.vector_norm(paths.position, dim=-1, keepdim=True)
    irradiance = compute_exact_direct_irradiance(shells, (zenith * paths.sun).sum(-1))
    light = paths.weights.estimate() * albedo / math.pi * irradiance
    direction = rotate_direction(zenith, draws[1].sqrt(), 2.0 * math.pi * draws[2])
    weights = paths.weights.times(albedo.expand_as(light), torch.ones_like(light))
    return light, _Paths(paths.lane, paths.position, direction, paths.sun, paths.hero, weights, paths.keys)
