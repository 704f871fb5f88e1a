"""Fused twin of `map_slices.find_lit_in_map`: slice by slice, so that a slice and its tree never leave the cache."""

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray

from render.fused import announce_compilation, run_in_threads
from render.shafts.fused_minmax_tree import collect, walk_ray, with_room
from render.shafts.lit_intervals import LitIntervals
from render.shafts.map_slices import MapSlices
from render.shafts.minmax_tree import SliceRays

CHUNK = 32
"""Slices of one call."""

Doubles = NDArray[np.float64]
Integers = NDArray[np.int64]


@njit(nogil=True, cache=True, error_model="numpy")
def _clip(start: float, heading: float, size: int, enter: float, leave: float) -> tuple[float, float]:
    """The part of enter..leave that a half-line spends over the map along one axis; leave <= enter for none."""
    if heading == 0.0:
        return (enter, leave) if 0.0 <= start < size else (leave, enter)
    first, last = (0.0 - start) / heading, (size - start) / heading
    return max(enter, min(first, last)), min(leave, max(first, last))


@njit(nogil=True, cache=True, error_model="numpy")
def _next_border(start: float, heading: float, place: float) -> float:
    """Number of the first border of texels that a half-line crosses behind a place; infinite if it never does."""
    if heading == 0.0:
        return np.inf
    at = start + place * heading
    border = np.floor(at) + 1.0 if heading > 0.0 else np.ceil(at) - 1.0
    return border


@njit(nogil=True, cache=True, error_model="numpy")
def _cut(depths: Doubles, start: Doubles, heading: Doubles, longest: float, edges: Doubles, leaves: Doubles) -> int:
    """Cells over the map of one half-line, neighbours of one depth as one; their number.

    The first of `edges` and `leaves` is left for the outside before the map.
    """
    rows, columns = depths.shape
    place, leave = _clip(start[0], heading[0], columns, 0.0, longest)
    place, leave = _clip(start[1], heading[1], rows, place, leave)
    edges[1], count = min(place, longest), 0
    column, row = _next_border(start[0], heading[0], place), _next_border(start[1], heading[1], place)
    towards = np.sign(heading)
    while place < leave:
        across = (column - start[0]) / heading[0] if heading[0] != 0.0 else np.inf
        down = (row - start[1]) / heading[1] if heading[1] != 0.0 else np.inf
        end = min(across, down, leave)
        if end > place:
            middle = 0.5 * (place + end)
            x = min(max(int(np.floor(start[0] + middle * heading[0])), 0), columns - 1)
            y = min(max(int(np.floor(start[1] + middle * heading[1])), 0), rows - 1)
            if count == 0 or leaves[count] != depths[y, x]:
                count += 1
                leaves[count] = depths[y, x]
            edges[count + 1] = end
            place = end
        if across <= end:
            column += towards[0]
        if down <= end:
            row += towards[1]
    return count


@njit(nogil=True, cache=True, error_model="numpy")
def _plant(edges: Doubles, leaves: Doubles, count: int, minimum: Doubles, maximum: Doubles) -> int:
    """Build the tree over the cells, the outside on both sides of them; its number of levels."""
    levels = 0
    while (1 << levels) < count + 2:
        levels += 1
    cells = 1 << levels
    edges[0], edges[count + 2 : cells + 1] = -np.inf, np.inf
    for cell in range(cells):
        outside = cell == 0 or cell == count + 1
        known = np.inf if outside or cell > count else leaves[cell]
        minimum[cells + cell] = known
        maximum[cells + cell] = known if cell <= count + 1 else -np.inf
    for node in range(cells - 1, 0, -1):
        minimum[node] = min(minimum[2 * node], minimum[2 * node + 1])
        maximum[node] = max(maximum[2 * node], maximum[2 * node + 1])
    return levels


@njit(nogil=True, cache=True, error_model="numpy")
def _find(
    depths: Doubles,
    start: Doubles,
    headings: Doubles,
    ends: Doubles,
    bounds: Integers,
    counts: Integers,
    first: int,
    last: int,
) -> Doubles:
    """Stretches of the rays of the slices from `first` to `last`; rays `bounds[s]` to `bounds[s + 1]` belong to slice s."""
    most = depths.shape[0] + depths.shape[1] + 8
    room = 1
    while room < most:
        room *= 2
    edges, leaves = np.empty(room + 1), np.empty(room)
    minimum, maximum = np.empty(2 * room), np.empty(2 * room)
    nodes = np.empty((2, 80), np.int64)
    found = np.empty((4 * (bounds[last] - bounds[first]) + 1, 2))
    total = 0
    for s in range(first, last):
        longest = 0.0
        for n in range(bounds[s], bounds[s + 1]):
            longest = max(longest, ends[0, n], ends[1, n])
        if bounds[s + 1] == bounds[s]:
            continue
        count = _cut(depths, start, headings[s], longest, edges, leaves)
        levels = _plant(edges, leaves, count, minimum, maximum)
        for n in range(bounds[s], bounds[s + 1]):
            before = total
            found = with_room(found, total, (1 << levels) + 1)
            total = walk_ray(edges, minimum, maximum, levels, ends, n, 0.0, 1.0, nodes, found, total)
            counts[n] = total - before
    return found[:total].copy()


def find_lit_slice_by_slice(slices: MapSlices, rays: SliceRays) -> LitIntervals:
    """As `find_lit_in_map`, in the threads that torch may use.

    Args:
        slices, rays: as there; quickest for rays in the order of their slices.

    Returns:
        The same stretches.
    """
    announce_compilation("fused_map_slices", _find.stats.cache_path)
    number = rays.slice_number
    ordered = bool((number[1:] >= number[:-1]).all())
    order = torch.arange(len(number)) if ordered else torch.argsort(number, stable=True)
    ends = (
        torch.stack([rays.start_place, rays.end_place, rays.start_depth, rays.end_depth])[:, order].contiguous().numpy()
    )
    bounds = torch.searchsorted(number[order].contiguous(), torch.arange(len(slices.heading) + 1)).numpy()
    counts = np.zeros(len(number), np.int64)
    depths, start, headings = (
        tensor.double().contiguous().numpy() for tensor in (slices.depths, slices.start, slices.heading)
    )
    parts: dict[int, Doubles] = {}

    def work(first: int, last: int) -> None:
        parts[first] = _find(depths, start, headings, ends, bounds, counts, first, last)

    run_in_threads(work, len(headings), CHUNK)
    found = collect(parts, counts, np.float64)
    if ordered:
        return found
    ray = order[found.ray]
    back = torch.argsort(ray, stable=True)
    return LitIntervals(ray[back], found.start[back], found.end[back], found.rays)
