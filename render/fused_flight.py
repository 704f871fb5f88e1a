"""Fused twin of `free_flight.fly` and of its marching loop alone; imported only where numba is installed."""

import math

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from render.fused import run_in_threads
from render.fused_scattering import HALF, Vector, chord
from render.fused_trilinear import Floats, interpolate, split_coordinate

CHUNK = 1 << 12

Bytes = NDArray[np.uint8]


@njit(nogil=True, cache=True, inline="always")
def _empty_steps(clearance: Bytes, x: float, y: float, z: float, fastest: float) -> int:
    """Further steps of a length in cells, along the axis where it is longest, that end where there is nothing."""
    i, _ = split_coordinate(x, clearance.shape[2] + 1)
    j, _ = split_coordinate(y, clearance.shape[1] + 1)
    k, _ = split_coordinate(z, clearance.shape[0] + 1)
    # A hundredth of a cell is left for rounding.
    return max(int((np.float32(clearance[k, j, i]) - np.float32(1.01)) / fastest), 0)


@njit(nogil=True, cache=True, inline="always")
def march(
    values: Floats,
    clearance: Bytes,
    start: tuple[float, float, float],
    rate: tuple[float, float, float],
    length: float,
    steps: int,
    target: float,
) -> tuple[bool, float, float]:
    """Follow one ray through the table until its optical length is used up, with leaps over empty space.

    Args:
        values: densities `(z, y, x)`.
        clearance: of their cells, see `measure_clearance`.
        start: table coordinates x, y, z of the first sample.
        rate: their change with each step.
        length: of a step [m].
        steps: number of them.
        target: optical length to use up [m].

    Returns:
        Whether that happened; the distance travelled until then [m]; the optical length passed [m].
    """
    half = np.float32(0.5)
    before = interpolate(values, start[0], start[1], start[2])
    passed, step = 0.0, 0
    fastest = max(abs(rate[0]), abs(rate[1]), abs(rate[2]), np.float32(1e-6))
    while step < steps:
        number = np.float32(step + 1)
        x, y, z = start[0] + rate[0] * number, start[1] + rate[1] * number, start[2] + rate[2] * number
        after = interpolate(values, x, y, z)
        increment = half * length * (before + after)
        if passed + increment > target:
            amount = (target - passed) / length
            root = math.sqrt(max(before * before + 2.0 * (after - before) * amount, 0.0))
            fraction = min(max(2.0 * amount / max(before + root, 1e-30), 0.0), 1.0)
            return True, np.float32((step + fraction) * length), np.float32(target)
        passed += increment
        before = after
        step += 1
        if after == 0.0:
            step += _empty_steps(clearance, x, y, z, fastest)
    return False, np.float32(0.0), np.float32(passed)


@njit(nogil=True, cache=True)
def fly(
    values: Floats, clearance: Bytes, box: Floats, stride: float, position: Vector, direction: Vector, target: float
) -> tuple[bool, Vector, float]:
    """One free flight: whether it ended inside, where, and the optical length passed. `box` holds corners and voxel size."""
    near, far = chord(box, position, direction)
    steps = max(math.ceil((far - near) / stride), 1)
    length = (far - near) / np.float32(steps)
    if not length > 0.0:
        return False, position, np.float32(0.0)
    start = (
        (position[0] + near * direction[0] - box[0, 0]) / box[2, 0] - HALF,
        (position[1] + near * direction[1] - box[0, 1]) / box[2, 1] - HALF,
        (position[2] + near * direction[2] - box[0, 2]) / box[2, 2] - HALF,
    )
    rate = (direction[0] / box[2, 0] * length, direction[1] / box[2, 1] * length, direction[2] / box[2, 2] * length)
    hit, travelled, passed = march(values, clearance, start, rate, length, steps, target)
    way = near + travelled
    end = (position[0] + way * direction[0], position[1] + way * direction[1], position[2] + way * direction[2])
    return hit, end, passed


@njit(nogil=True, cache=True, error_model="numpy")
def _march_rays(
    values: Floats,
    clearance: Bytes,
    start: Floats,
    rate: Floats,
    length: Floats,
    steps: Floats,
    target: Floats,
    collided: NDArray[np.bool_],
    travelled: Floats,
    passed: Floats,
    first: int,
    last: int,
) -> None:
    for n in range(first, last):
        if length[n] > 0.0:
            collided[n], travelled[n], passed[n] = march(
                values,
                clearance,
                (start[n, 0], start[n, 1], start[n, 2]),
                (rate[n, 0], rate[n, 1], rate[n, 2]),
                length[n],
                int(steps[n]),
                target[n],
            )


@torch.library.custom_op("cloudfit::march_flights", mutates_args=())
def march_flights(
    values: Tensor, clearance: Tensor, start: Tensor, rate: Tensor, length: Tensor, steps: Tensor, target: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Follow rays until their optical lengths are used up.

    Args:
        values: densities `(z, y, x)`, no axis shorter than two.
        clearance: of their cells, see `measure_clearance`.
        start: table coordinates x, y, z of the first samples `(ray, 3)`.
        rate: their change with each step `(ray, 3)`.
        length: of the steps `(ray,)` [m]; rays of length zero are not followed.
        steps: number of them `(ray,)`.
        target: optical lengths to use up `(ray,)` [m].

    Returns:
        Whether that happened, the distance travelled until then [m] and the optical length passed [m], each `(ray,)`.
    """
    collided = torch.zeros(len(length), dtype=torch.bool)
    travelled, passed = torch.zeros_like(length), torch.zeros_like(length)
    arrays = [tensor.contiguous().numpy() for tensor in (values, clearance, start, rate, length, steps, target)]
    results = [tensor.numpy() for tensor in (collided, travelled, passed)]
    run_in_threads(lambda first, last: _march_rays(*arrays, *results, first, last), len(length), CHUNK)
    return collided, travelled, passed
