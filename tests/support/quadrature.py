"""Slow, plain integrals of the light in a uniform box, in float64, that share no code with what they test."""

import math

import numpy as np

Array = np.ndarray


def phase(cosine: Array | float, asymmetry: float) -> Array:
    """Henyey-Greenstein as printed [1/sr]."""
    g = asymmetry
    return (1.0 - g * g) / (4.0 * math.pi * (1.0 + g * g - 2.0 * g * np.asarray(cosine)) ** 1.5)


def exit_distance(point: Array, direction: Array, half: Array) -> Array:
    """Distance from points inside a box around the origin to its border; `(..., 3)` to `(...)`."""
    with np.errstate(divide="ignore"):
        return np.where(direction == 0.0, np.inf, (np.copysign(half, direction) - point) / direction).min(-1)


def box_single(
    start: Array, direction: Array, sun: Array, half: Array, extinction: float, steps: int = 20_000
) -> float:
    """Single scattering without phase function of a ray that starts at a point of the box: midpoints."""
    length = exit_distance(start, direction, half)
    t = (np.arange(steps) + 0.5) / steps * length
    to_sun = exit_distance(start + t[:, None] * direction, sun, half)
    return float((extinction * np.exp(-extinction * (t + to_sun))).mean() * length)


def sphere_grid(polar: int, around: int) -> Array:
    """Directions `(polar * around, 3)` that share the sphere evenly: midpoints in cosine and azimuth."""
    z = (2.0 * (np.arange(polar) + 0.5) / polar - 1.0)[:, None]
    angle = (2.0 * math.pi * (np.arange(around) + 0.5) / around)[None]
    sine = np.sqrt(1.0 - z * z)
    return np.stack(np.broadcast_arrays(sine * np.cos(angle), sine * np.sin(angle), z), axis=-1).reshape(-1, 3)


def box_source(
    point: Array, direction: Array, sun: Array, half: Array, extinction: float, asymmetry: float, steps: int = 60
) -> float:
    """Radiance scattered twice that a point of a uniform box scatters towards a camera ray: sphere times midpoints."""
    outwards = sphere_grid(90, 120)
    length = exit_distance(point, outwards, half)
    r = (np.arange(steps) + 0.5) / steps * length[:, None]
    second = point + r[..., None] * outwards[:, None]
    to_sun = exit_distance(second, np.broadcast_to(sun, second.shape), half)
    along = (extinction * np.exp(-extinction * (r + to_sun))).mean(1) * length
    both = phase(outwards @ direction, asymmetry) * phase(outwards @ sun, asymmetry)
    return float(4.0 * math.pi * (along * both).mean())


def box_double(
    start: Array, direction: Array, sun: Array, half: Array, extinction: float, asymmetry: float, nodes: int = 12
) -> float:
    """Double scattering of a ray that starts at a point of a uniform box: Gauss-Legendre nodes of `box_source`."""
    length = float(exit_distance(start, direction, half))
    abscissa, weight = np.polynomial.legendre.leggauss(nodes)
    distance = 0.5 * (abscissa + 1.0) * length
    source = [box_source(start + d * direction, direction, sun, half, extinction, asymmetry) for d in distance]
    return float((weight * extinction * np.exp(-extinction * distance) * source).sum() * 0.5 * length)
