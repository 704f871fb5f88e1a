"""Fused twin of the flights of `drawn_flights`; imported only where numba is installed."""

import math

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from precompute.drawn_flights import BITS, FRACTIONS, SMALLEST_QUANTILE
from render.fused import announce_compilation, run_in_threads
from render.fused_flight import Bytes, fly
from render.fused_scattering import Doubles
from render.fused_trilinear import Floats

CHUNK = 1 << 9
"""Points of a call."""

Ints = NDArray[np.int32]
Medium = tuple[Floats, Bytes, Floats, float]
"""Densities; clearance of their cells; corners and voxel size of their box; marching step."""
Points = tuple[Floats, Floats, Ints, Floats, Doubles]
"""Corner, spacing and counts of their lattice; positions, and shifts of their quantiles."""
Directions = tuple[Floats, Doubles]
"""Unit vectors and quantiles."""

ZERO, ONE, MOST = np.float32(0.0), np.float32(1.0), np.float32(FRACTIONS)


@njit(nogil=True, cache=True, inline="always")
def _place(corner: float, spacing: float, count: int, coordinate: float) -> tuple[int, int]:
    """Cell along an axis, and place within it in whole numbers."""
    place = (coordinate - corner) / spacing
    cell = min(max(np.int32(place), np.int32(0)), max(count - np.int32(2), np.int32(0)))
    within = min(max(place - np.float32(cell), ZERO), ONE)
    return cell, np.int16(np.rint(within * MOST))


@njit(nogil=True, cache=True, error_model="numpy")
def _draw_points(
    medium: Medium,
    points: Points,
    directions: Directions,
    extinction: Doubles,
    cell: Ints,
    fraction: NDArray[np.int16],
    first: int,
    last: int,
) -> None:
    values, clearance, box, stride = medium
    low, spacing, counts, position, shift = points
    # Direction by direction, whose ends are written side by side.
    for d in range(len(directions[0])):
        vector, quantile = directions[0][d], directions[1][d]
        along = (vector[0], vector[1], vector[2])
        for n in range(first, last):
            moved = (shift[n] + quantile) % 1.0
            depth = -math.log1p(-min(max(moved, SMALLEST_QUANTILE), 1.0 - SMALLEST_QUANTILE))
            place, passed = (position[n, 0], position[n, 1], position[n, 2]), 0.0
            for s in range(len(extinction) - 1, -1, -1):
                length = depth / extinction[s]
                inside, place, _ = fly(values, clearance, box, stride, place, along, np.float32(length - passed))
                if not inside:
                    break
                passed = length
                i, u = _place(low[0], spacing[0], counts[0], place[0])
                j, v = _place(low[1], spacing[1], counts[1], place[1])
                k, w = _place(low[2], spacing[2], counts[2], place[2])
                cell[s, d, n] = i + counts[0] * (j + counts[1] * k)
                fraction[s, d, n] = u + (v << BITS) + (w << (2 * BITS))


@torch.library.custom_op("cloudfit::draw_flight_ends", mutates_args=("cell", "fraction"))
def draw_flight_ends(
    values: Tensor,
    clearance: Tensor,
    box: Tensor,
    stride: float,
    corner: Tensor,
    spacing: Tensor,
    counts: Tensor,
    position: Tensor,
    shift: Tensor,
    direction: Tensor,
    quantile: Tensor,
    extinction: Tensor,
    cell: Tensor,
    fraction: Tensor,
) -> None:
    """Where flights end.

    Args:
        values: densities `(z, y, x)`, no axis shorter than two.
        clearance: of their cells, see `measure_clearance`.
        box: lower and upper corner and voxel size `(3, 3)` [m].
        stride: longest marching step [m].
        corner, spacing: of the points' lattice `(3,)` [m].
        counts: of its points along x, y and z `(3,)` int32.
        position: of the points `(point, 3)` [m].
        shift: of the quantiles of each point `(point,)`, float64.
        direction: unit vectors `(direction, 3)`.
        quantile: of each direction `(direction,)`, float64.
        extinction: rising `(extinction,)` [1/m], float64.
        cell, fraction: receive the ends, see `DrawnFlights`, `(extinction, direction, point)` int32 and int16; untouched for flights that
            left.
    """
    announce_compilation("fused_drawn_flights", _draw_points.stats.cache_path)
    medium = (values.numpy(), clearance.numpy(), box.numpy(), np.float32(stride))
    points = tuple(tensor.contiguous().numpy() for tensor in (corner, spacing, counts, position, shift))
    directions, nodes = (direction.contiguous().numpy(), quantile.numpy()), extinction.numpy()
    results = cell.numpy(), fraction.numpy()
    run_in_threads(lambda a, b: _draw_points(medium, points, directions, nodes, *results, a, b), len(shift), CHUNK)
