"""Sunlight that is scattered once, twice, ... on its way to the eye, by Monte Carlo: what the methods of marching leave out.

A path starts at the eye. Each leg ends in a collision within the air: its distance is drawn from the collisions before the first
surface (`FlightDistribution`), and the path's weight is multiplied by their probability 1 - exp(-tau) and by the albedo. At its
k-th collision it gathers

    weight  p(cosine)  exp(-A)  V

p being the phase function towards the sun, A the optical depth to it, and V whether it is seen, by a ray of its own. Then it goes on in a
direction drawn from the phase function. Surfaces absorb: light that they reflect is none of the air's.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import torch
from torch import Tensor

from render.errors import ParameterError
from render.media import FlightDistribution, compute_optical_depth
from render.phase_functions import rotate_direction, sample_phase_cosine
from render.random_streams import child_generator
from render.rayleigh_phase import sample_rayleigh_cosine
from render.shafts.air import Constituent
from render.shafts.lights import Sun
from render.shafts.ray_casting import SunRays
from render.shafts.rays import ViewRays
from render.shafts.stage import Stage

PATHS_AT_ONCE = 1 << 16
"""Paths in flight."""

COSINE_SAMPLERS: Mapping[str, Callable[[float, Tensor], Tensor]] = MappingProxyType(
    {
        "rayleigh": lambda _, uniform: sample_rayleigh_cosine(uniform),
        "henyey_greenstein": lambda asymmetry, uniform: sample_phase_cosine(uniform.new_tensor(asymmetry), uniform),
    }
)
"""Of each phase function of `render.shafts.air`: asymmetry and uniform numbers to scattering cosines."""


@dataclass(frozen=True, eq=False)
class ScatteredOrders:
    """In-scattered sunlight by the number of scatterings, for a sun of irradiance 1.

    Args:
        mean: `(order, pixel)`, the first being single scattering.
        variance: of these means `(order, pixel)`.
        samples: paths of each pixel.
    """

    mean: Tensor
    variance: Tensor
    samples: int


def trace_orders(stage: Stage, orders: int, samples: int, seed: int = 0) -> ScatteredOrders:
    """Trace paths from every pixel.

    Args:
        stage: a scene under a sun of one point with one constituent of white colour; lamps and ambient light are left out.
        orders: largest number of scatterings, at least 1.
        samples: paths of each pixel, at least 2.
        seed: of the random numbers.

    Returns:
        Means and variances, float64.

    Raises:
        ParameterError: for another air, no sun, or fewer orders or samples.
    """
    parts, sun = stage.scene.air.constituents, stage.lighting.sun
    level = len(parts) == 1 and parts[0].colour == (1.0, 1.0, 1.0) and not stage.scene.air.banks
    if not level or sun is None or stage.lighting.more_suns:
        raise ParameterError("paths of several scatterings need a sun of one point, and air of one white constituent")
    if orders < 1 or samples < 2:
        raise ParameterError(f"expected at least one order and two samples, got {orders} and {samples}")
    pixels = len(stage.rays)
    total = torch.zeros(orders, pixels, dtype=torch.float64)
    square = torch.zeros_like(total)
    chunk = max(1, PATHS_AT_ONCE // pixels)
    for number, first in enumerate(range(0, samples, chunk)):
        count = min(chunk, samples - first)
        chosen = torch.arange(pixels).repeat(count)
        generator = child_generator(seed, number)
        for order, value in enumerate(_follow(stage, parts[0], sun.light, stage.rays[chosen], orders, generator)):
            values = value.double().reshape(count, pixels)
            total[order] += values.sum(0)
            square[order] += values.square().sum(0)
    mean = total / samples
    variance = (square / samples - mean.square()).clamp(min=0.0) / (samples - 1)
    return ScatteredOrders(mean, variance, samples)


def _follow(
    stage: Stage, part: Constituent, sun: Sun, rays: ViewRays, orders: int, generator: torch.Generator
) -> list[Tensor]:
    """What each collision of each path gathers `(path,)`, order by order."""
    position, direction, distance = rays.origin, rays.direction, rays.distance
    weight = torch.ones_like(distance)
    towards, seen = position.new_tensor(sun.direction), SunRays(stage.caster, sun.direction)
    gathered = []
    for order in range(orders):
        if order:
            cosine = COSINE_SAMPLERS[part.phase](part.asymmetry, _uniform(weight, generator))
            direction = rotate_direction(direction, cosine, 2.0 * torch.pi * _uniform(weight, generator))
            distance = stage.caster.find_distance(position, direction)
        flown, probability = _fly(part, position, direction, distance, _uniform(weight, generator))
        weight = weight * part.albedo * probability
        position = position + flown[:, None] * direction
        arriving = torch.exp(-sun.compute_depth(stage.scene.air, position[:, 2])[:, 0])
        phase = part.evaluate_phase((direction @ towards).clamp(-1.0, 1.0))
        gathered.append(torch.where(seen.look_up_lit(position), weight * phase * arriving, 0.0))
    return gathered


def _fly(
    part: Constituent, position: Tensor, direction: Tensor, distance: Tensor, uniform: Tensor
) -> tuple[Tensor, Tensor]:
    """Distance to a collision [m], and the probability that there is one; 0 and 0 where there is no air."""
    height, slope = position[:, 2].double(), direction[:, 2].double().clamp(-1.0, 1.0)
    flights = FlightDistribution(part.medium, height, slope, None, distance.double())
    depth = compute_optical_depth(flights.medium, height, slope, distance.double())
    flown = flights.invert_cdf(uniform.double())
    collides = torch.isfinite(flown)
    probability = torch.where(collides, -torch.expm1(-depth), 0.0)
    return torch.where(collides, flown, 0.0).to(position), probability.to(position)


def _uniform(like: Tensor, generator: torch.Generator) -> Tensor:
    return torch.rand(len(like), generator=generator, dtype=like.dtype)
