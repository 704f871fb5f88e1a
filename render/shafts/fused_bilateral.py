"""Fused twin of one pass of `bilateral`; imported only where numba is installed."""

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from render.fused import announce_compilation, run_in_threads
from render.shafts.bilateral import Taps

ROWS = 16
"""Rows of one call."""

Floats = NDArray[np.float32]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]


@njit(nogil=True, cache=True, error_model="numpy")
def _fill(
    axis: int, values: Floats, valid: Booleans, known: Floats, wanted: Floats, number: Integers, near: Floats, nearest: Integers,
    step: float, smallest: float, result: Floats, matched: Booleans, first: int, last: int,
) -> None:  # fmt: skip
    """As `bilateral._fill_along`, for the rows from `first` to `last`."""
    channels = values.shape[2]
    sums = np.empty(channels)
    for row in range(first, last):
        for column in range(wanted.shape[1]):
            place = column if axis == 1 else row
            depth, total, best_gap, best = wanted[row, column], 0.0, np.inf, nearest[place]
            sums[:] = 0.0
            for tap in range(number.shape[1]):
                weight, source = near[place, tap], number[place, tap]
                i, j = (row, source) if axis == 1 else (source, column)
                if not weight > 0.0 or not valid[i, j]:
                    continue
                other = known[i, j]
                gap = 0.0 if other == depth else abs(other - depth)
                if gap < best_gap:
                    best_gap, best = gap, source
                if gap > 0.0:
                    weight *= np.exp(-0.5 * (gap / step) * (gap / step))
                total += weight
                for c in range(channels):
                    sums[c] += weight * values[i, j, c]
            i, j = (row, best) if axis == 1 else (best, column)
            for c in range(channels):
                result[row, column, c] = sums[c] / total if total >= smallest else values[i, j, c]
            matched[row, column] = best_gap <= step


def fill_along(
    axis: int, values: Tensor, valid: Tensor, known_depth: Tensor, wanted_depth: Tensor, taps: Taps, step: float
) -> tuple[Tensor, Tensor]:
    """As `bilateral._fill_along`, in float32, in the threads that torch may use.

    Args:
        axis: 0 to fill columns, 1 to fill rows.
        values: marched ones `(row, column, channel)`, `axis` being the reduced one.
        valid: which of them are matched `(row, column)`.
        known_depth: logarithms of their depths `(row, column)`.
        wanted_depth: the same of all pixels of the result `(row, column)`.
        taps: along the axis.
        step: tolerance of the logarithms.

    Returns:
        Values `(row, column, channel)`, and which of them are matched.
    """
    announce_compilation("fused_bilateral", _fill.stats.cache_path)
    result = np.empty((*wanted_depth.shape, values.shape[-1]), np.float32)
    matched = np.empty(tuple(wanted_depth.shape), np.bool_)
    tensors = (values, valid, known_depth, wanted_depth, taps.number, taps.near, taps.nearest)
    arrays = [tensor.contiguous().numpy() for tensor in tensors]
    smallest = float(np.finfo(np.float32).tiny)

    def work(first: int, last: int) -> None:
        _fill(axis, *arrays, step, smallest, result, matched, first, last)

    run_in_threads(work, len(result), ROWS)
    return torch.from_numpy(result), torch.from_numpy(matched)
