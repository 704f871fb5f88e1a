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
def sees_lamp(cubes: Floats, k: int, dx: float, dy: float, dz: float, square: float) -> bool:
    """As `CubeShadowMap.look_up_lit`, for one offset from the light, which may be scaled: `square` is that of its scale."""
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
    scale = 0.5 * size / abs(main)
    column = min(max(int(0.5 * size + first * scale), 0), size - 1)
    row = min(max(int(0.5 * size + second * scale), 0), size - 1)
    first_surface = cubes[k, 2 * axis + (1 if main < 0.0 else 0), row, column]
    return dx * dx + dy * dy + dz * dz <= square * float(first_surface) * float(first_surface)


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
def turn_by(angle: float) -> tuple[float, float]:
    """Cosine and sine of an angle [rad]; the series are exact to 1e-11 where they are used."""
    if abs(angle) > 0.5:
        return np.cos(angle), np.sin(angle)
    y = angle * angle
    cosine = 1.0 - y * (0.5 - y * (1.0 / 24.0 - y * (1.0 / 720.0 - y * (1.0 / 40320.0 - y * (1.0 / 3628800.0)))))
    return cosine, angle * (1.0 - y * (1.0 / 6.0 - y * (1.0 / 120.0 - y * (1.0 / 5040.0 - y * (1.0 / 362880.0)))))


@loop
def _look_at_lamp(cubes: Floats, k: int, line: Line, c: float, s: float) -> bool:
    """Whether the place at an angle is lit, by its cosine and sine; the direction of `line` is as long as h."""
    x, y, z, dx, dy, dz = line
    return sees_lamp(cubes, k, c * x + s * dx, c * y + s * dy, c * z + s * dz, c * c)


@loop
def _halve_angle(
    cubes: Floats, k: int, line: Line, c: float, s: float, far_c: float, far_s: float, before: bool, halvings: int
) -> float:
    """Share of an angle before the border of a shadow, one end of it being lit and the other not."""
    low, size = 0.0, 1.0
    for _ in range(halvings):
        middle_c, middle_s = c + far_c, s + far_s
        length = 1.0 / np.sqrt(middle_c * middle_c + middle_s * middle_s)
        middle_c, middle_s, size = middle_c * length, middle_s * length, 0.5 * size
        if _look_at_lamp(cubes, k, line, middle_c, middle_s) == before:
            c, s, low = middle_c, middle_s, low + size
        else:
            far_c, far_s = middle_c, middle_s
    return low + 0.5 * size


@loop
def lamp_share(
    cubes: Floats, k: int, line: Line, h: float, s: float, c: float, angle: float, count: int, halvings: int
) -> float:
    """The same for point light k, as a share of the angle under which it sees a step.

    `line` starts at the place nearest to the light, whose distance with that of the radius is h; `s` and `c` are the sine and cosine of the
    angle at which the step begins.
    """
    part, total = angle / count, 0.0
    x, y, z, dx, dy, dz = line
    # With t = h tan(theta), cos(theta) times the offset from the light is cos(theta) times this place and h sin(theta) times the direction.
    line = (x, y, z, h * dx, h * dy, h * dz)
    half_c, half_s = turn_by(0.5 * part)
    turn_c, turn_s = 1.0 - 2.0 * half_s * half_s, 2.0 * half_c * half_s
    if halvings == 0:
        c, s = c * half_c - s * half_s, s * half_c + c * half_s
        for _ in range(count):
            total += 1.0 if _look_at_lamp(cubes, k, line, c, s) else 0.0
            c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
        return total / count
    before = _look_at_lamp(cubes, k, line, c, s)
    for _ in range(count):
        next_c, next_s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
        after = _look_at_lamp(cubes, k, line, next_c, next_s)
        if before == after:
            total += 1.0 if after else 0.0
        else:
            border = _halve_angle(cubes, k, line, c, s, next_c, next_s, before, halvings)
            total += border if before else 1.0 - border
        before, c, s = after, next_c, next_s
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
def lamp_line(lamps: Doubles, k: int, rays: Floats, n: int, nearest: float) -> Line:
    """A ray relative to point light k, from a place on it."""
    dx, dy, dz = float(rays[n, 3]), float(rays[n, 4]), float(rays[n, 5])
    x, y, z = rays[n, 0] - lamps[k, 0], rays[n, 1] - lamps[k, 1], rays[n, 2] - lamps[k, 2]
    return x + nearest * dx, y + nearest * dy, z + nearest * dz, dx, dy, dz
