"""The reference path tracer: plain, unbiased, slow. Everything else is tested against it.

A path starts at the camera. Free flights are drawn by delta tracking (Woodcock et al. 1965), so the trilinear density is
sampled without any quadrature; at each collision the sun is connected by ratio tracking (Novak et al. 2014), an unbiased
estimate of the transmittance; then the path goes on in a direction drawn from the phase function. A path's contribution at
its k-th collision is

    p(cos_sun; g) T(x_k, sun),     times albedo^k and the sun's intensity in the total.

Nothing is shared with the precomputed tables but the density look-up, the phase function and the source of random numbers. A path's
random numbers depend on the seed, its pixel and its own number only; `fused_path_tracer` follows the same paths one by one.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.camera import Camera, unit_direction
from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.fused import fused_loops_wanted
from render.phase_functions import check_asymmetry, evaluate_phase_function, rotate_direction, sample_phase_cosine
from render.random_streams import counter_keys, counter_uniform, stream_number

LANES = 1 << 17
"""Paths in flight at once; bounds the memory."""

PATHS_PER_PIXEL = 1 << 32
"""Numbers that the paths of a pixel may have."""

SPENT, SURVIVAL = 0.01, 0.5
"""Transmittance to the sun below which Russian roulette ends its estimate, and the probability to go on."""


@dataclass(frozen=True, eq=False)
class ReferenceImage:
    """Monte Carlo estimate of every pixel for a sun of unit intensity, with the variance of each estimate.

    Args:
        orders: mean radiance per scattering order `(order, pixel)` at albedo one; entry 0 is single scattering.
        orders_variance: variance of those means `(order, pixel)`.
        radiance: sum over orders of albedo^k times order k `(pixel,)`.
        radiance_variance: variance of that mean `(pixel,)`, with the correlation of the orders.
        transmittance: share of paths that cross the volume without a collision `(pixel,)`.
        transmittance_variance: its variance `(pixel,)`.
        samples: paths per pixel.
    """

    orders: Tensor
    orders_variance: Tensor
    radiance: Tensor
    radiance_variance: Tensor
    transmittance: Tensor
    transmittance_variance: Tensor
    samples: int


@dataclass(frozen=True, eq=False)
class Medium:
    """A volume at one extinction under the sun."""

    grid: DensityGrid
    extinction: float
    sun: Tensor

    @property
    def majorant(self) -> float:
        """Largest extinction [1/m]."""
        return self.extinction * self.grid.maximum


def trace_reference(
    grid: DensityGrid,
    camera: Camera,
    sun_direction: Tensor,
    *,
    extinction: float,
    asymmetry: float,
    albedo: float,
    orders: int,
    samples: int,
    seed: int = 0,
    pixels: Tensor | None = None,
    recorded: int | None = None,
) -> ReferenceImage:
    """Path trace a cloud lit by the sun.

    Args:
        grid: the volume.
        camera: one ray through each pixel centre.
        sun_direction: towards the sun `(3,)`, of any length.
        extinction: of density one [1/m], not negative.
        asymmetry: of the Henyey-Greenstein phase function.
        albedo: single-scattering albedo in 0..1; enters the total only.
        orders: largest number of scatterings.
        samples: paths per pixel, at least two.
        seed: of the random streams.
        pixels: numbers of those to trace `(pixel,)`, all by default; the others stay as if they saw no cloud.
        recorded: orders that get an image of their own, all by default; the sum holds every one. In a bright thick cloud thousands
            of orders count, and their images would not fit the memory.

    Returns:
        Means and variances for a sun of unit intensity.

    Raises:
        ParameterError: for a parameter outside its domain.
    """
    check_asymmetry(asymmetry)
    kept = orders if recorded is None else recorded
    if not (0.0 <= extinction < float("inf")) or not 0.0 <= albedo <= 1.0 or not 1 <= kept <= orders or samples < 2:
        raise ParameterError(
            "need extinction >= 0, albedo in 0..1, orders >= 1, at most as many recorded and samples >= 2, not "
            f"{extinction}, {albedo}, {orders}, {kept}, {samples}"
        )
    origin, direction = camera.rays()
    near, far = grid.intersect(origin, direction)
    seen = torch.nonzero(far > near).flatten() if grid.maximum * extinction > 0.0 else torch.empty(0, dtype=torch.long)
    if pixels is not None:
        seen = pixels[torch.isin(pixels, seen)]
    sums = _Sums(len(origin), kept)
    medium = Medium(grid, extinction, unit_direction(sun_direction))
    start = origin[seen] + near[seen, None] * direction[seen]
    rays = _Rays(seen, start, direction[seen], samples, orders, stream_number(seed))
    trace = _trace_fused if fused_loops_wanted(grid.density) else _trace
    trace(medium, rays, asymmetry, albedo, sums)
    return sums.finish(samples)


@dataclass(frozen=True, eq=False)
class _Rays:
    """Numbers of the pixels, where their rays enter the volume and whereto, paths of each, orders, and the stream of random numbers."""

    pixel: Tensor
    start: Tensor
    direction: Tensor
    samples: int
    orders: int
    stream: int


class _Sums:
    """Sums and sums of squares per pixel, in float64."""

    def __init__(self, pixels: int, orders: int) -> None:
        self.order_sum = torch.zeros(orders, pixels, dtype=torch.float64)
        self.order_square = torch.zeros_like(self.order_sum)
        self.total_sum = torch.zeros(pixels, dtype=torch.float64)
        self.total_square = torch.zeros_like(self.total_sum)
        self.collided = torch.zeros_like(self.total_sum)

    def add_order(self, order: int, pixel: Tensor, value: Tensor) -> None:
        self.order_sum[order].index_add_(0, pixel, value)
        self.order_square[order].index_add_(0, pixel, value * value)

    def add_path(self, pixel: Tensor, total: Tensor) -> None:
        self.total_sum.index_add_(0, pixel, total)
        self.total_square.index_add_(0, pixel, total * total)

    def finish(self, samples: int) -> ReferenceImage:
        """Means, and the variances of the means, after `samples` paths from each pixel."""

        def moments(total: Tensor, square: Tensor) -> tuple[Tensor, Tensor]:
            mean = total / samples
            variance = (square / samples - mean * mean).clamp(min=0.0) / (samples - 1)
            return mean.float(), variance.float()

        orders, orders_variance = moments(self.order_sum, self.order_square)
        radiance, radiance_variance = moments(self.total_sum, self.total_square)
        opacity, opacity_variance = moments(self.collided, self.collided)
        return ReferenceImage(
            orders, orders_variance, radiance, radiance_variance, 1.0 - opacity, opacity_variance, samples
        )


def _trace_fused(medium: Medium, rays: _Rays, asymmetry: float, albedo: float, sums: _Sums) -> None:
    """All paths in one fused loop."""
    from render.fused_path_tracer import trace_paths  # needs numba

    box = torch.stack([medium.grid.lower, medium.grid.upper, medium.grid.voxel_size])
    found = trace_paths(
        medium.grid.table.padded,
        box,
        medium.grid.maximum,
        medium.majorant,
        medium.sun,
        rays.pixel * PATHS_PER_PIXEL,
        rays.start,
        rays.direction,
        rays.samples,
        rays.stream,
        asymmetry,
        albedo,
        rays.orders,
        len(sums.order_sum),
    )
    for name, values in zip(("order_sum", "order_square", "total_sum", "total_square", "collided"), found, strict=True):
        getattr(sums, name)[..., rays.pixel] = values


def _trace(medium: Medium, rays: _Rays, asymmetry: float, albedo: float, sums: _Sums) -> None:
    """All paths, a batch of lanes at a time."""
    for first in range(0, len(rays.pixel) * rays.samples, LANES):
        path = torch.arange(first, min(first + LANES, len(rays.pixel) * rays.samples))
        ray = path // rays.samples
        counter = rays.pixel[ray] * PATHS_PER_PIXEL + path % rays.samples
        draws = _Draws(counter_keys(rays.stream, counter), torch.zeros_like(path))
        _trace_batch(
            medium, rays.pixel[ray], rays.start[ray], rays.direction[ray], rays.orders, asymmetry, albedo, sums, draws
        )


class _Draws:
    """Random numbers of paths, each of which counts its own."""

    def __init__(self, keys: Tensor, drawn: Tensor) -> None:
        self._keys, self._drawn = keys, drawn

    def next(self, lane: Tensor) -> Tensor:
        """One more number of some of the paths `(lane,)`."""
        number = counter_uniform(self._keys[lane], self._drawn[lane])
        self._drawn[lane] += 1
        return number

    def keep(self, lanes: Tensor) -> "_Draws":
        """The numbers of some of the paths."""
        return _Draws(self._keys[lanes], self._drawn[lanes])


def _trace_batch(
    medium: Medium,
    pixel: Tensor,
    position: Tensor,
    direction: Tensor,
    orders: int,
    asymmetry: float,
    albedo: float,
    sums: _Sums,
    draws: _Draws,
) -> None:
    """Trace one batch of paths through all orders and add them to the sums."""
    total = torch.zeros(len(pixel), dtype=torch.float64)
    lane = torch.arange(len(pixel))
    for order in range(orders):
        collided, position = _fly(medium, position, direction, draws)
        lane, position, direction, draws = lane[collided], position[collided], direction[collided], draws.keep(collided)
        if order == 0:
            sums.collided.index_add_(0, pixel[lane], torch.ones(len(lane), dtype=torch.float64))
        if len(lane) == 0:
            break
        cosine = direction @ medium.sun
        transmittance = _estimate_sun_transmittance(medium, position, draws)
        value = (evaluate_phase_function(cosine, asymmetry) * transmittance).double()
        if order < len(sums.order_sum):
            sums.add_order(order, pixel[lane], value)
        total[lane] += albedo ** (order + 1) * value
        every = torch.arange(len(lane))
        turn = sample_phase_cosine(torch.full_like(cosine, asymmetry), draws.next(every))
        direction = rotate_direction(direction, turn, 2.0 * math.pi * draws.next(every))
    sums.add_path(pixel, total)


def _fly(medium: Medium, position: Tensor, direction: Tensor, draws: _Draws) -> tuple[Tensor, Tensor]:
    """Free flights by delta tracking: which paths collide `(ray,)`, and where `(ray, 3)`."""
    _, far = medium.grid.intersect(position, direction)
    distance = torch.zeros_like(far)
    collided = torch.zeros(len(far), dtype=torch.bool)
    active = torch.nonzero(far > 0).flatten()
    while len(active):
        travelled = distance[active] - draws.next(active).log() / medium.majorant
        distance[active] = travelled
        inside = travelled < far[active]
        density = _density_along(medium.grid, position[active], direction[active], travelled.minimum(far[active]))
        hit = inside & (draws.next(active) * medium.grid.maximum < density)
        collided[active[hit]] = True
        active = active[inside & ~hit]
    return collided, position + distance[:, None] * direction


def _estimate_sun_transmittance(medium: Medium, position: Tensor, draws: _Draws) -> Tensor:
    """Unbiased transmittance towards the sun `(ray,)` by ratio tracking, with Russian roulette once it is spent."""
    direction = medium.sun.expand_as(position)
    _, far = medium.grid.intersect(position, direction)
    transmittance = torch.ones_like(far)
    distance = torch.zeros_like(far)
    active = torch.nonzero(far > 0).flatten()
    while len(active):
        travelled = distance[active] - draws.next(active).log() / medium.majorant
        distance[active] = travelled
        inside = travelled < far[active]
        density = _density_along(medium.grid, position[active], direction[active], travelled.minimum(far[active]))
        kept = torch.where(inside, transmittance[active] * (1.0 - density / medium.grid.maximum), transmittance[active])
        survives = draws.next(active) < SURVIVAL
        kept = torch.where(inside & (kept < SPENT), torch.where(survives, kept / SURVIVAL, 0.0), kept)
        transmittance[active] = kept
        active = active[inside & (kept > 0.0)]
    return transmittance


def _density_along(grid: DensityGrid, position: Tensor, direction: Tensor, distance: Tensor) -> Tensor:
    """Density `(ray,)` at a distance along each ray; points beyond the box are held at its border.

    The distance must be finite: a free flight in a very thin medium overflows, and infinity times a zero component is no number.
    """
    x, y, z = grid.voxel_coordinates(position + distance[:, None] * direction).unbind(-1)
    return grid.table.look_up(x, y, z)
