"""Fused twins of the loops of `carried_orders`; imported only where numba is installed."""

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from precompute.drawn_flights import BITS, FRACTIONS
from render.fused import announce_compilation, run_in_threads
from render.fused_trilinear import Floats

CHUNK = 1 << 12
"""Points of a call."""

Ints = NDArray[np.int32]

ONE, SIX, CELL = np.float32(1.0), np.float32(6.0), np.float32(1.0 / FRACTIONS)


@njit(nogil=True, cache=True, fastmath=True)
def _sharpen(light: Floats, neighbours: Ints, spread: Floats, sharp: Floats, first: int, last: int) -> None:
    for h in range(len(light)):
        values = light[h]
        for n in range(first, last):
            a, b, c = neighbours[n, 0], neighbours[n, 1], neighbours[n, 2]
            d, e, f = neighbours[n, 3], neighbours[n, 4], neighbours[n, 5]
            taken = spread[n]
            kept = ONE + SIX * taken
            for q in range(light.shape[2]):
                around = values[a, q] + values[b, q] + values[c, q] + values[d, q] + values[e, q] + values[f, q]
                sharp[h, n, q] = kept * values[n, q] - taken * around


@njit(nogil=True, cache=True, fastmath=True)
def _gather(
    along: Floats,
    entry: Ints,
    strides: Ints,
    cell: Ints,
    fraction: NDArray[np.int16],
    brought: Floats,
    first: int,
    last: int,
) -> None:
    sx, sy, sz = strides[0], strides[1], strides[2]
    # Direction by direction, whose values at all points fit the cache.
    for direction in range(len(along)):
        values, end = along[direction], np.int32(along.shape[1] - 1)
        for n in range(first, last):
            low, bits = cell[direction, n], fraction[direction, n]
            if low < 0:
                brought[direction, n, :] = np.float32(0.0)
                continue
            u, v, w = (
                np.float32(bits & FRACTIONS) * CELL,
                np.float32(bits >> BITS & FRACTIONS) * CELL,
                np.float32(bits >> 2 * BITS) * CELL,
            )
            near, far, upper, top = (ONE - w) * (ONE - v), (ONE - w) * v, w * (ONE - v), w * v
            # Points are numbered along x first, and a cell where flights end has all its corners.
            a, c, e, g = entry[low], entry[low + sy], entry[low + sz], entry[low + sz + sy]
            b, d, f, h = min(a + sx, end), min(c + sx, end), min(e + sx, end), min(g + sx, end)
            for q in range(along.shape[2]):
                left = near * values[a, q] + far * values[c, q] + upper * values[e, q] + top * values[g, q]
                right = near * values[b, q] + far * values[d, q] + upper * values[f, q] + top * values[h, q]
                brought[direction, n, q] = (ONE - u) * left + u * right


@torch.library.custom_op("cloudfit::sharpen_light", mutates_args=("sharp",))
def sharpen_light(light: Tensor, neighbours: Tensor, spread: Tensor, sharp: Tensor) -> None:
    """`LightLattice.sharpen` for every harmonic: values and results `(harmonic, point, column)`, neighbours `(point, 6)` int32, spread
    `(point,)`. Results are written to memory that is there: that of new tensors as large takes longer to get than to fill."""
    announce_compilation("fused_gather", _gather.stats.cache_path)
    arrays = [tensor.contiguous().numpy() for tensor in (light, neighbours, spread, sharp)]
    run_in_threads(lambda first, last: _sharpen(*arrays, first, last), light.shape[1], CHUNK)


@torch.library.custom_op("cloudfit::gather_flights", mutates_args=("brought",))
def gather_flights(
    along: Tensor, entry: Tensor, counts: Tensor, cell: Tensor, fraction: Tensor, brought: Tensor
) -> None:
    """Values where flights end.

    Args:
        along: values at the points for each direction `(direction, point, column)`.
        entry: number of each lattice point among the points `(lattice point,)` int32.
        counts: of the lattice's points along x, y and z `(3,)`.
        cell, fraction: of the ends, see `DrawnFlights`, `(direction, point)` int32 and int16.
        brought: receives them `(direction, point, column)`, zero for flights that left.
    """
    # Along an axis of one point both corners are that one.
    strides = torch.stack([torch.ones_like(counts[0]), counts[0], counts[0] * counts[1]]) * (counts > 1)
    arrays = [tensor.contiguous().numpy() for tensor in (along, entry, strides.int(), cell, fraction, brought)]
    run_in_threads(lambda first, last: _gather(*arrays, first, last), along.shape[1], CHUNK)
