"""Banks of fog in the fused march: densities and optical lengths to the lights; imported only where numba is installed."""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from render.shafts.fog_bank import FogBank, Shades
from render.shafts.fused_shadows import OPTIONS, Doubles, Floats
from render.shafts.lights import Lighting
from render.trilinear import TrilinearTable

loop = njit(**OPTIONS)

Wholes = NDArray[np.int64]

Banks = tuple[Floats, Wholes, Doubles, Doubles]
"""All tables end to end; where each begins and its shape `(1 + light, bank, 4)`, the first row being the densities, those of the sun in the
second, the begin -1 where there is none; lower and upper corner and edges of a voxel of each bank `(bank, 9)`; and of each light whether
it is near, and its position or else direction `(light, 4)`."""


@loop
def _look_up(banks: Banks, row: int, b: int, x: float, y: float, z: float) -> float:
    """As `TrilinearTable.look_up`; no axis of a table is shorter than two."""
    values, places = banks[0], banks[1]
    start, deep, high, wide = places[row, b, 0], places[row, b, 1], places[row, b, 2], places[row, b, 3]
    x, y, z = min(max(x, 0.0), wide - 1.0), min(max(y, 0.0), high - 1.0), min(max(z, 0.0), deep - 1.0)
    i, j, k = min(int(x), wide - 2), min(int(y), high - 2), min(int(z), deep - 2)
    u, v, w = x - i, y - j, z - k
    at = start + (k * high + j) * wide + i
    up = at + high * wide
    low = (1.0 - v) * ((1.0 - u) * values[at] + u * values[at + 1])
    low += v * ((1.0 - u) * values[at + wide] + u * values[at + wide + 1])
    top = (1.0 - v) * ((1.0 - u) * values[up] + u * values[up + 1])
    top += v * ((1.0 - u) * values[up + wide] + u * values[up + wide + 1])
    return (1.0 - w) * low + w * top


@loop
def measure_banks(
    banks: Banks, layers: Doubles, rays: Floats, n: int, begin: float, end: float, greys: Doubles
) -> None:
    """Grey optical depths of a step, in the last places of the first part of `greys`; as `FogBank.compute_depth`."""
    boxes, middle = banks[2], 0.5 * (begin + end)
    x, y, z = rays[n, 0] + middle * rays[n, 3], rays[n, 1] + middle * rays[n, 4], rays[n, 2] + middle * rays[n, 5]
    first = len(layers) - len(boxes)
    for b in range(len(boxes)):
        density = 0.0
        if (
            boxes[b, 0] <= x <= boxes[b, 3]
            and boxes[b, 1] <= y <= boxes[b, 4]
            and boxes[b, 2] <= z <= boxes[b, 5]
            and end > begin
        ):
            u = (x - boxes[b, 0]) / boxes[b, 6] - 0.5
            v = (y - boxes[b, 1]) / boxes[b, 7] - 0.5
            w = (z - boxes[b, 2]) / boxes[b, 8] - 0.5
            density = _look_up(banks, 0, b, u, v, w)
        greys[first + b] = layers[first + b, 1] * density * (end - begin)


@loop
def _clip(low: float, high: float, place: float, rate: float, near: float, far: float) -> tuple[float, float]:
    """Part of a stretch of a ray that lies between two planes; one that ends before it begins if there is none."""
    if abs(rate) < 1e-30:
        return (near, far) if low <= place <= high else (0.0, -1.0)
    first, last = (low - place) / rate, (high - place) / rate
    return max(near, min(first, last)), min(far, max(first, last))


@loop
def _bank_length(banks: Banks, row: int, b: int, x: float, y: float, z: float) -> float:
    """Optical length through one bank from a point to light `row` - 1; as `LightLengths.look_up`."""
    boxes, lights = banks[2], banks[3]
    if banks[1][row, b, 0] < 0:
        return 0.0
    near, far = 0.0, np.inf
    dx, dy, dz = lights[row, 1], lights[row, 2], lights[row, 3]
    if lights[row, 0] > 0.0:
        dx, dy, dz = dx - x, dy - y, dz - z
        far = np.sqrt(dx * dx + dy * dy + dz * dz)
        if far == 0.0:
            return 0.0
        dx, dy, dz = dx / far, dy / far, dz / far
    distance = far
    near, far = _clip(boxes[b, 0], boxes[b, 3], x, dx, near, np.inf)
    near, far = _clip(boxes[b, 1], boxes[b, 4], y, dy, near, far)
    near, far = _clip(boxes[b, 2], boxes[b, 5], z, dz, near, far)
    if not (far > near and near < distance):
        return 0.0
    u = (x + near * dx - boxes[b, 0]) / boxes[b, 6]
    v = (y + near * dy - boxes[b, 1]) / boxes[b, 7]
    w = (z + near * dz - boxes[b, 2]) / boxes[b, 8]
    return _look_up(banks, row, b, u, v, w)


@loop
def light_through_banks(
    banks: Banks, layers: Doubles, row: int, rays: Floats, n: int, t: float, channels: int, found: Doubles, first: int
) -> None:
    """What all banks leave of light `row` - 1 at a place on a ray, by channel, written to `found` from a place on."""
    x, y, z = rays[n, 0] + t * rays[n, 3], rays[n, 1] + t * rays[n, 4], rays[n, 2] + t * rays[n, 5]
    for c in range(channels):
        found[first + c] = 1.0
    for b in range(len(banks[2])):
        layer = len(layers) - len(banks[2]) + b
        length = layers[layer, 1] * _bank_length(banks, row, b, x, y, z)
        for c in range(channels):
            found[first + c] *= np.exp(-layers[layer, 6 + c] * length)


def bank_arrays(banks: Sequence[FogBank], lighting: Lighting) -> Banks:
    """Everything about banks that the loops read. The sun has a row, whether there is one or not."""
    shades: list[Shades] = [() if lighting.sun is None else lighting.sun.shades]
    shades += [point.shades for point in lighting.points]
    parts: list[Floats] = [np.zeros(0, np.float32)]
    places = np.full((2 + len(lighting.points), len(banks), 4), -1, np.int64)
    boxes, lights = np.zeros((len(banks), 9)), np.zeros((2 + len(lighting.points), 4))
    used = 0
    for b, bank in enumerate(banks):
        boxes[b] = np.concatenate([part.numpy() for part in (bank.grid.lower, bank.grid.upper, bank.grid.voxel_size)])
        lengths = [one[b] if len(one) > b else None for one in shades]
        tables: list[TrilinearTable | None] = [bank.grid.table]
        tables += [None if one is None else one.table for one in lengths]
        for row, table in enumerate(tables):
            if table is not None:
                places[row, b] = (used, *table.padded.shape)
                parts.append(table.padded.reshape(-1).numpy())
                used += table.padded.numel()
    if lighting.sun is not None:
        lights[1, 1:] = lighting.sun.light.direction
    for number, point in enumerate(lighting.points):
        lights[2 + number] = (1.0, *point.light.position)
    return np.concatenate(parts), places, boxes, lights
