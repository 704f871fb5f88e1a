"""Fused twin of the walk down the min-max tree in `minmax_tree`; imported only where numba is installed."""

import math
from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray

from render.fused import announce_compilation, run_in_threads
from render.shafts.lit_intervals import LitIntervals
from render.shafts.minmax_tree import MinMaxTree, SliceRays

CHUNK = 1 << 12
"""Rays of one call."""

Row = NDArray[Any]
"""Numbers of the precision of the tree, float32 or float64; the loop adds no constant of another precision to them."""


@njit(nogil=True, cache=True, error_model="numpy")
def _fraction(edge: float, start: float, extent: float, zero: float, one: float) -> float:
    """As `SliceRays.fraction_at`."""
    if extent == zero:
        return one if edge > start else zero
    return min(max((edge - start) / extent, zero), one)


@njit(nogil=True, cache=True, error_model="numpy")
def _put(stretches: Row, count: int, start: float, end: float, joins: bool) -> int:
    """Add a stretch, or lengthen the last one if that ends where this begins; the new number of stretches."""
    if joins and stretches[count - 1, 1] == start:
        stretches[count - 1, 1] = end
        return count
    stretches[count, 0], stretches[count, 1] = start, end
    return count + 1


@njit(nogil=True, cache=True, error_model="numpy")
def walk_ray(
    edges: Row, minimum: Row, maximum: Row, levels: int, ends: Row, n: int, zero: float, one: float,
    nodes: NDArray[np.int64], found: Row, total: int,
) -> int:  # fmt: skip
    """Stretches of ray n of `ends` through one slice of 2^levels cells, in order, behind the `total` first rows of `found`.

    Args:
        edges, minimum, maximum: a row of each tensor of a `MinMaxTree`.
        levels: of the tree.
        ends: first and last place, first and last depth of the rays `(4, ray)`.
        n: number of the ray.
        zero, one: in the precision of the tree.
        nodes: room for nodes and their levels `(2, levels + 2)`.
        found: room for as many stretches as cells, and one.
        total: stretches there.

    Returns:
        The number of stretches that are there now.
    """
    cells, begun, held = 1 << levels, total, 1
    start, extent = ends[0, n], ends[1, n] - ends[0, n]
    shallow, slope = ends[2, n], ends[3, n] - ends[2, n]
    nodes[0, 0], nodes[1, 0] = 1, levels
    while held > 0:
        held -= 1
        node, level = nodes[0, held], nodes[1, held]
        cell = (node << level) - cells
        low = _fraction(edges[cell], start, extent, zero, one)
        high = _fraction(edges[cell + (1 << level)], start, extent, zero, one)
        if low == high:
            continue
        enter, leave = min(low, high), max(low, high)
        enter_depth, leave_depth = shallow + enter * slope, shallow + leave * slope
        if max(enter_depth, leave_depth) <= minimum[node]:
            total = _put(found, total, enter, leave, total > begun)
        elif min(enter_depth, leave_depth) <= maximum[node]:
            if level > 0:
                backwards = 1 if extent < zero else 0
                nodes[0, held], nodes[0, held + 1] = 2 * node + 1 - backwards, 2 * node + backwards
                nodes[1, held] = nodes[1, held + 1] = level - 1
                held += 2
                continue
            crossing = min(max((minimum[node] - shallow) / slope, enter), leave)
            if enter_depth <= minimum[node]:
                leave = crossing
            else:
                enter = crossing
            if leave > enter:
                total = _put(found, total, enter, leave, total > begun)
    return total


@njit(nogil=True, cache=True, error_model="numpy")
def with_room(found: Row, total: int, more: int) -> Row:
    """The array itself, or one twice as long with the same first rows if `more` rows would not fit."""
    if total + more <= len(found):
        return found
    larger = np.empty((2 * (total + more), 2), found.dtype)
    larger[:total] = found[:total]
    return larger


@njit(nogil=True, cache=True, error_model="numpy")
def _walk(
    edges: Row, minimum: Row, maximum: Row, ends: Row, slices: NDArray[np.int64], levels: int, zero: float, one: float,
    counts: NDArray[np.int64], first: int, last: int,
) -> Row:  # fmt: skip
    """Stretches `(interval, 2)` of the rays from `first` to `last`, in order; their numbers go to `counts`."""
    found = np.empty((4 * (last - first), 2), edges.dtype)
    nodes = np.empty((2, levels + 2), np.int64)
    total = 0
    for n in range(first, last):
        row, before = slices[n], total
        found = with_room(found, total, edges.shape[1])
        total = walk_ray(edges[row], minimum[row], maximum[row], levels, ends, n, zero, one, nodes, found, total)
        counts[n] = total - before
    return found[:total].copy()


def walk_down(tree: MinMaxTree, rays: SliceRays) -> LitIntervals:
    """As `find_lit_intervals`, for a tree and rays of one precision, in the threads that torch may use.

    Args:
        tree, rays: as there.

    Returns:
        The same stretches in every bit.
    """
    announce_compilation("fused_minmax_tree", _walk.stats.cache_path)
    edges, minimum, maximum = tree.edges.numpy(), tree.minimum.numpy(), tree.maximum.numpy()
    ends = torch.stack([rays.start_place, rays.end_place, rays.start_depth, rays.end_depth]).numpy()
    slices = rays.slice_number.to(torch.int64).contiguous().numpy()
    counts = np.zeros(len(slices), np.int64)
    levels = int(math.log2(tree.cells))
    zero, one = edges.dtype.type(0), edges.dtype.type(1)
    parts: dict[int, Row] = {}

    def work(first: int, last: int) -> None:
        parts[first] = _walk(edges, minimum, maximum, ends, slices, levels, zero, one, counts, first, last)

    run_in_threads(work, len(slices), CHUNK)
    return collect(parts, counts, edges.dtype)


def collect(parts: dict[int, Row], counts: NDArray[np.int64], dtype: Any) -> LitIntervals:
    """Stretches of rays from those of chunks.

    Args:
        parts: stretches `(interval, 2)` of each chunk by its first ray.
        counts: number of stretches of each ray.
        dtype: of the stretches, for no chunks at all.

    Returns:
        The stretches of all rays.
    """
    stretches = torch.from_numpy(np.concatenate([parts[first] for first in sorted(parts)] or [np.empty((0, 2), dtype)]))
    ray = torch.repeat_interleave(torch.arange(len(counts)), torch.from_numpy(counts))
    return LitIntervals(ray, stretches[:, 0].contiguous(), stretches[:, 1].contiguous(), len(counts))
