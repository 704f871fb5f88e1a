"""Fused twin of `TrilinearTable.look_up`; imported only where numba is installed."""

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from render.fused import run_in_threads

CHUNK = 1 << 15

Floats = NDArray[np.float32]


@njit(nogil=True, cache=True, inline="always")
def split_coordinate(coordinate: float, samples: int) -> tuple[int, float]:
    """Cell and fraction along an axis of two or more samples; coordinates outside, and NaN, are held at its ends."""
    held = coordinate if coordinate > 0.0 else np.float32(0.0)
    held = min(held, np.float32(samples - 1))
    cell = min(np.int64(held), samples - 2)
    return cell, held - np.float32(cell)


@njit(nogil=True, cache=True, inline="always")
def interpolate(values: Floats, x: float, y: float, z: float) -> float:
    """Trilinear value at table coordinates; no axis of the table is shorter than two."""
    i, u = split_coordinate(x, values.shape[2])
    j, v = split_coordinate(y, values.shape[1])
    k, w = split_coordinate(z, values.shape[0])
    near_00 = values[k, j, i] + w * (values[k + 1, j, i] - values[k, j, i])
    near_01 = values[k, j, i + 1] + w * (values[k + 1, j, i + 1] - values[k, j, i + 1])
    near_10 = values[k, j + 1, i] + w * (values[k + 1, j + 1, i] - values[k, j + 1, i])
    near_11 = values[k, j + 1, i + 1] + w * (values[k + 1, j + 1, i + 1] - values[k, j + 1, i + 1])
    row_0 = near_00 + v * (near_10 - near_00)
    row_1 = near_01 + v * (near_11 - near_01)
    return row_0 + u * (row_1 - row_0)


@njit(nogil=True, cache=True, error_model="numpy")
def _look_up(values: Floats, x: Floats, y: Floats, z: Floats, found: Floats, first: int, last: int) -> None:
    for n in range(first, last):
        found[n] = interpolate(values, x[n], y[n], z[n])


@torch.library.custom_op("cloudfit::look_up_trilinear", mutates_args=())
def look_up_trilinear(values: Tensor, x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """Values `(point,)` of a table `(z, y, x)` without axes of length one at coordinates `(point,)`, all float32."""
    found = torch.empty_like(x)
    table, out = values.numpy(), found.numpy()
    columns = [coordinate.contiguous().numpy() for coordinate in (x, y, z)]
    run_in_threads(lambda first, last: _look_up(table, *columns, out, first, last), len(out), CHUNK)
    return found
