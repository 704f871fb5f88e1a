"""Fused twin of the reference path tracer's loop; imported only where numba is installed."""

import numpy as np
import torch
from numba import njit
from torch import Tensor

from render.fused import announce_compilation, run_in_threads
from render.fused_scattering import (
    GOLDEN,
    HALF,
    Doubles,
    Floats,
    Vector,
    chord,
    cosine_between,
    mix,
    phase,
    turn,
    uniform,
)
from render.fused_trilinear import interpolate
from render.path_tracer import SPENT, SURVIVAL

CHUNK = 4
"""Pixels of one call."""

Medium = tuple[Floats, Floats, float, float]
"""Densities; corners and voxel size of their box; largest density; majorant [1/m]."""
Sums = tuple[Doubles, Doubles, Doubles, Doubles, Doubles]
"""As of `_Sums`."""

SPENT_SINGLE, SURVIVAL_SINGLE, ONE = np.float32(SPENT), np.float32(SURVIVAL), np.float32(1.0)


@njit(nogil=True, cache=True)
def _density(values: Floats, box: Floats, position: Vector, direction: Vector, distance: float) -> float:
    x = (position[0] + distance * direction[0] - box[0, 0]) / box[2, 0] - HALF
    y = (position[1] + distance * direction[1] - box[0, 1]) / box[2, 1] - HALF
    z = (position[2] + distance * direction[2] - box[0, 2]) / box[2, 2] - HALF
    return interpolate(values, x, y, z)


@njit(nogil=True, cache=True, error_model="numpy")
def _fly(medium: Medium, position: Vector, direction: Vector, key: int, drawn: int) -> tuple[bool, Vector, int]:
    """One free flight: whether it ended in a collision, where, and how many random numbers have been drawn."""
    values, box, maximum, majorant = medium
    far = chord(box, position, direction)[1]
    travelled = np.float32(0.0)
    while far > 0.0:
        travelled -= np.float32(np.log(uniform(key, drawn))) / majorant
        accepted = uniform(key, drawn + 1) * maximum
        drawn += 2
        if not travelled < far:
            break
        if accepted < _density(values, box, position, direction, travelled):
            end = (
                position[0] + travelled * direction[0],
                position[1] + travelled * direction[1],
                position[2] + travelled * direction[2],
            )
            return True, end, drawn
    return False, position, drawn


@njit(nogil=True, cache=True, error_model="numpy")
def _estimate_transmittance(medium: Medium, position: Vector, sun: Vector, key: int, drawn: int) -> tuple[float, int]:
    """Transmittance to the sun, and how many random numbers have been drawn."""
    values, box, maximum, majorant = medium
    far = chord(box, position, sun)[1]
    travelled, kept = np.float32(0.0), ONE
    while far > 0.0 and kept > 0.0:
        travelled -= np.float32(np.log(uniform(key, drawn))) / majorant
        survives = uniform(key, drawn + 1) < SURVIVAL_SINGLE
        drawn += 2
        if not travelled < far:
            break
        kept *= ONE - _density(values, box, position, sun, travelled) / maximum
        if kept < SPENT_SINGLE:
            kept = kept / SURVIVAL_SINGLE if survives else np.float32(0.0)
    return kept, drawn


@njit(nogil=True, cache=True, error_model="numpy")
def _trace_path(
    medium: Medium,
    sun: Vector,
    position: Vector,
    direction: Vector,
    key: int,
    asymmetry: float,
    albedo: float,
    orders: int,
    ray: int,
    sums: Sums,
) -> None:
    """Follow one path and add it to the sums of its ray."""
    order_sum, order_square, total_sum, total_square, collided = sums
    total, drawn, power = 0.0, 0, 1.0
    for order in range(orders):
        hit, position, drawn = _fly(medium, position, direction, key, drawn)
        if not hit:
            break
        if order == 0:
            collided[ray] += 1.0
        transmittance, drawn = _estimate_transmittance(medium, position, sun, key, drawn)
        value = phase(cosine_between(direction, sun), asymmetry) * transmittance
        power *= albedo
        if order < len(order_sum):
            order_sum[order, ray] += value
            order_square[order, ray] += value * value
        total += power * value
        direction = turn(direction, asymmetry, uniform(key, drawn), uniform(key, drawn + 1))
        drawn += 2
    total_sum[ray] += total
    total_square[ray] += total * total


@njit(nogil=True, cache=True)
def _trace_rays(
    medium: Medium,
    sun: Vector,
    rays: tuple[Floats, Floats],
    counters: np.ndarray,
    samples: int,
    stream: int,
    asymmetry: float,
    albedo: float,
    orders: int,
    sums: Sums,
    first: int,
    last: int,
) -> None:
    start, ahead = rays
    for ray in range(first, last):
        position = (start[ray, 0], start[ray, 1], start[ray, 2])
        direction = (ahead[ray, 0], ahead[ray, 1], ahead[ray, 2])
        for sample in range(samples):
            key = mix(stream + np.uint64(counters[ray] + sample + 1) * GOLDEN)
            _trace_path(medium, sun, position, direction, key, asymmetry, albedo, orders, ray, sums)


@torch.library.custom_op("cloudfit::trace_reference_paths", mutates_args=())
def trace_paths(
    values: Tensor,
    box: Tensor,
    maximum: float,
    majorant: float,
    sun: Tensor,
    counters: Tensor,
    start: Tensor,
    direction: Tensor,
    samples: int,
    stream: int,
    asymmetry: float,
    albedo: float,
    orders: int,
    recorded: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Trace paths along rays and sum their contributions.

    Args:
        values: densities `(z, y, x)`, no axis shorter than two.
        box: lower corner, upper corner and edges of a voxel `(3, 3)` [m].
        maximum: largest density.
        majorant: extinction at the largest density [1/m].
        sun: unit vector towards the sun `(3,)`.
        counters: number of the first path of each ray `(ray,)`.
        start: where the rays enter the volume `(ray, 3)` [m].
        direction: of the rays `(ray, 3)`.
        samples: paths of each.
        stream: from `stream_number`.
        asymmetry, albedo: of the medium.
        orders: largest number of scatterings.
        recorded: orders with sums of their own.

    Returns:
        Sums and sums of squares of the orders `(order, ray)`, those of the whole `(ray,)`, and paths that collided `(ray,)`; float64.
    """
    announce_compilation("fused_path_tracer", _trace_rays.stats.cache_path)
    order_sums = [torch.zeros(recorded, len(start), dtype=torch.float64) for _ in range(2)]
    ray_sums = [torch.zeros(len(start), dtype=torch.float64) for _ in range(3)]
    medium = (values.numpy(), box.numpy(), np.float32(maximum), np.float32(majorant))
    towards = tuple(np.float32(component) for component in sun.tolist())
    rays = (start.contiguous().numpy(), direction.contiguous().numpy())
    sums = tuple(tensor.numpy() for tensor in (*order_sums, *ray_sums))
    numbers, lobe, key = counters.numpy(), np.float32(asymmetry), np.uint64(stream)

    def work(first: int, last: int) -> None:
        _trace_rays(medium, towards, rays, numbers, samples, key, lobe, albedo, orders, sums, first, last)

    run_in_threads(work, len(start), CHUNK)
    return order_sums[0], order_sums[1], ray_sums[0], ray_sums[1], ray_sums[2]
