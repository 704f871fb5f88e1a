"""Random numbers, directions and phase functions of one path at a time, for the fused loops; imported only where numba is installed."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from render.fused_trilinear import Floats
from render.random_streams import FIRST_FACTOR, GOLDEN_RATIO, SECOND_FACTOR

Doubles = NDArray[np.float64]
Vector = tuple[float, float, float]

GOLDEN, FIRST, SECOND = (np.uint64(factor) for factor in (GOLDEN_RATIO, FIRST_FACTOR, SECOND_FACTOR))
S27, S30, S31, S41 = (np.uint64(places) for places in (27, 30, 31, 41))
ONE, TWO, HALF = np.float32(1.0), np.float32(2.0), np.float32(0.5)
CELL = np.float32(2.0**-23)
TINY = np.finfo(np.float32).tiny


@njit(nogil=True, cache=True, inline="always")
def mix(state: np.uint64) -> np.uint64:
    """See `random_streams`."""
    state = (state ^ (state >> S30)) * FIRST
    state = (state ^ (state >> S27)) * SECOND
    return state ^ (state >> S31)


@njit(nogil=True, cache=True, inline="always")
def uniform(key: np.uint64, dimension: int) -> float:
    """See `counter_uniform`."""
    bits = mix(key + np.uint64(dimension + 1) * GOLDEN)
    return (np.float32(bits >> S41) + HALF) * CELL


@njit(nogil=True, cache=True, inline="always")
def phase(cosine: float, asymmetry: float) -> float:
    """See `evaluate_phase_function`."""
    size = abs(asymmetry)
    peak = (ONE - size) * (ONE - size) + TWO * max(size - asymmetry * cosine, np.float32(0.0))
    return (1.0 - asymmetry * asymmetry) / (4.0 * math.pi * peak * math.sqrt(peak))


@njit(nogil=True, cache=True)
def turn(axis: Vector, asymmetry: float, first: float, second: float) -> Vector:
    """Direction drawn from a lobe around an axis; see `sample_phase_cosine` and `rotate_direction`."""
    xi = TWO * first - ONE
    q = (ONE - asymmetry * asymmetry) / (ONE + asymmetry * xi)
    cosine = HALF * ((ONE + q) * (asymmetry + xi) / (ONE + asymmetry * xi) + asymmetry)
    cosine = min(max(cosine, -ONE), ONE)
    x, y, z = axis
    sign = ONE if z >= 0.0 else -ONE
    a = -ONE / (sign + z)
    b = x * y * a
    sine = np.float32(math.sqrt(max((ONE - cosine) * (ONE + cosine), np.float32(0.0))))
    azimuth = np.float32(2.0 * math.pi) * second
    u, v = sine * np.float32(math.cos(azimuth)), sine * np.float32(math.sin(azimuth))
    turned_x = u * (ONE + sign * x * x * a) + v * b + cosine * x
    turned_y = u * (sign * b) + v * (sign + y * y * a) + cosine * y
    turned_z = -u * (sign * x) - v * y + cosine * z
    scale = ONE / np.float32(math.sqrt(turned_x * turned_x + turned_y * turned_y + turned_z * turned_z))
    return turned_x * scale, turned_y * scale, turned_z * scale


@njit(nogil=True, cache=True)
def chord(box: Floats, position: Vector, direction: Vector) -> tuple[float, float]:
    """Distances at which a ray enters and leaves the box; equal if it misses. See `DensityGrid.intersect`."""
    near, far = np.float32(0.0), np.float32(np.inf)
    for axis in range(3):
        p, d = position[axis], direction[axis]
        if abs(d) < TINY:
            if p < box[0, axis] or p > box[1, axis]:
                return np.float32(0.0), np.float32(0.0)
        else:
            inverse = ONE / d
            one, other = (box[0, axis] - p) * inverse, (box[1, axis] - p) * inverse
            near, far = max(near, min(one, other)), min(far, max(one, other))
    if far > near:
        return near, far
    return np.float32(0.0), np.float32(0.0)


@njit(nogil=True, cache=True, inline="always")
def cosine_between(one: Vector, other: Vector) -> float:
    """Of the angle between two unit vectors."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
