"""Shadow look-ups of the fused march: the maps of `ShadowMap` and `CubeShadowMap` along a ray; imported only where numba is installed."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]

# Numba counts references to every array that passes through a function, with locked instructions that cost more than the arithmetic here.
# These functions only use arrays of their callers, so they do without.
OPTIONS = {"nogil": True, "cache": True, "error_model": "numpy", "_nrt": False}
loop = njit(**OPTIONS)


Line = tuple[float, float, float, float, float, float]
"""A ray as a light sees it: three coordinates where it begins, and how they change along it."""


@loop
def sees_sun(tops: Floats, u: float, v: float, w: float) -> bool:
    """As `ShadowMap.look_up_lit`, at place (u, v) [texel] of the map and w along its third axis."""
    if not (u >= 0.0 and v >= 0.0 and u < tops.shape[1] and v < tops.shape[0]):
        return True
    return w >= tops[int(v), int(u)]


@loop
def sees_lamp(cubes: Floats, k: int, dx: float, dy: float, dz: float) -> bool:
    """As `CubeShadowMap.look_up_lit`, for one offset from the light."""
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if ax >= ay and ax >= az:
        axis, main, first, second = 0, dx, dy, dz
    elif ay >= az:
        axis, main, first, second = 1, dy, dz, dx
    else:
        axis, main, first, second = 2, dz, dx, dy
    if main == 0.0:
        return True
    size = cubes.shape[2]
    column = min(max(int((0.5 + 0.5 * first / abs(main)) * size), 0), size - 1)
    row = min(max(int((0.5 + 0.5 * second / abs(main)) * size), 0), size - 1)
    first_surface = cubes[k, 2 * axis + (1 if main < 0.0 else 0), row, column]
    return dx * dx + dy * dy + dz * dz <= float(first_surface) * float(first_surface)


@loop
def sun_share(tops: Floats, line: Line, begin: float, length: float, count: int, halvings: int) -> float:
    """Lit share of one step of one ray, as `_lit_share` of the torch loop."""
    u, v, w, du, dv, dw = line
    total, part = 0.0, length / count
    if halvings == 0:
        for j in range(count):
            t = begin + (j + 0.5) * part
            total += 1.0 if sees_sun(tops, u + t * du, v + t * dv, w + t * dw) else 0.0
        return total / count
    before = sees_sun(tops, u + begin * du, v + begin * dv, w + begin * dw)
    for j in range(count):
        low = begin + j * part
        high, t = low + part, low + part
        after = sees_sun(tops, u + t * du, v + t * dv, w + t * dw)
        if before == after:
            total += 1.0 if after else 0.0
        else:
            for _ in range(halvings):
                t = 0.5 * (low + high)
                if sees_sun(tops, u + t * du, v + t * dv, w + t * dw) == before:
                    low = t
                else:
                    high = t
            border = (0.5 * (low + high) - begin) / part - j
            total += border if before else 1.0 - border
        before = after
    return total / count


@loop
def lamp_share(cubes: Floats, k: int, line: Line, begin: float, length: float, count: int, halvings: int) -> float:
    """The same for point light k."""
    x, y, z, dx, dy, dz = line
    total, part = 0.0, length / count
    if halvings == 0:
        for j in range(count):
            t = begin + (j + 0.5) * part
            total += 1.0 if sees_lamp(cubes, k, x + t * dx, y + t * dy, z + t * dz) else 0.0
        return total / count
    before = sees_lamp(cubes, k, x + begin * dx, y + begin * dy, z + begin * dz)
    for j in range(count):
        low = begin + j * part
        high, t = low + part, low + part
        after = sees_lamp(cubes, k, x + t * dx, y + t * dy, z + t * dz)
        if before == after:
            total += 1.0 if after else 0.0
        else:
            for _ in range(halvings):
                t = 0.5 * (low + high)
                if sees_lamp(cubes, k, x + t * dx, y + t * dy, z + t * dz) == before:
                    low = t
                else:
                    high = t
            border = (0.5 * (low + high) - begin) / part - j
            total += border if before else 1.0 - border
        before = after
    return total / count


@loop
def sun_line(frame: Doubles, rays: Floats, n: int) -> Line:
    """A ray in the coordinates of the sun's map."""
    x, y, z, dx, dy, dz = rays[n, 0], rays[n, 1], rays[n, 2], rays[n, 3], rays[n, 4], rays[n, 5]
    return (
        frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z + frame[0, 3],
        frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z + frame[1, 3],
        frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z + frame[2, 3],
        frame[0, 0] * dx + frame[0, 1] * dy + frame[0, 2] * dz,
        frame[1, 0] * dx + frame[1, 1] * dy + frame[1, 2] * dz,
        frame[2, 0] * dx + frame[2, 1] * dy + frame[2, 2] * dz,
    )


@loop
def lamp_line(lamps: Doubles, k: int, rays: Floats, n: int) -> Line:
    """A ray relative to point light k."""
    x, y, z = rays[n, 0] - lamps[k, 0], rays[n, 1] - lamps[k, 1], rays[n, 2] - lamps[k, 2]
    return x, y, z, float(rays[n, 3]), float(rays[n, 4]), float(rays[n, 5])
