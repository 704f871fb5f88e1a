"""Fog over round ground by plain quadrature: straight rays in space, heights from distances to the centre, no parabola anywhere."""

from collections.abc import Callable

import numpy as np

Array = np.ndarray

X, W = np.polynomial.legendre.leggauss(40)
X, W = 0.5 * (X + 1.0), 0.5 * W
PANELS = np.concatenate([[0.0], np.logspace(-5.0, 0.0, 26)])


def _panels(length: Array) -> tuple[Array, Array]:
    """Nodes and weights (..., node) on 0..length, finer towards 0."""
    size = np.diff(PANELS)
    nodes = (PANELS[:-1, None] + size[:, None] * X).ravel()
    weights = (size[:, None] * W).ravel()
    return length[..., None] * nodes, length[..., None] * weights


def sun_depth(
    extinction: Callable[[Array], Array], ceiling: float, height: Array, slope: Array, radius: float
) -> Array:
    """Optical depth [1] from heights [m] to the sun; infinite in the shadow of the ground, which lies at height 0."""
    r = radius + height
    along = r * slope
    reach = -along + np.sqrt(np.maximum(along**2 + (ceiling - height) * (2.0 * radius + ceiling + height), 0.0))
    s, weight = _panels(np.maximum(reach, 0.0))
    rise = (2.0 * along[..., None] * s + s * s) / (
        np.sqrt(r[..., None] ** 2 + 2.0 * along[..., None] * s + s * s) + r[..., None]
    )
    depth = (weight * extinction(height[..., None] + rise)).sum(-1)
    lowest = r * np.sqrt(np.maximum(1.0 - slope**2, 0.0)) - radius
    return np.where((slope < 0.0) & (lowest < 0.0), np.inf, depth)


def round_in_scattering(
    extinction: Callable[[Array], Array],
    ceiling: float,
    eye: float,
    slope: float,
    sun_slope: float,
    distance: float,
    radius: float,
    azimuth: float | None,
) -> float:
    """Sunlight scattered once into a view ray.

    Without an azimuth between view and sun the view ray is straight over flat ground and the sun equally high along
    it, so that the paths to the sun alone are round; with one everything is.
    """
    if azimuth is None:
        distance = min(distance, (ceiling - eye) / slope if slope > 0.0 else distance)
        t, weight = _panels(np.array(distance))
        height, sun = eye + slope * t, np.full_like(t, sun_slope)
        inner, share = _panels(t)
        before = (share * extinction(eye + slope * inner)).sum(-1)
    else:
        cosine = slope * sun_slope + np.cos(azimuth) * np.sqrt((1.0 - slope**2) * (1.0 - sun_slope**2))
        t, weight = _panels(np.array(distance))
        r = radius + eye
        centre = np.sqrt(r * r + 2.0 * r * slope * t + t * t)
        height = eye + (2.0 * r * slope * t + t * t) / (centre + r)
        sun = (r * sun_slope + t * cosine) / centre
        inner, share = _panels(t)
        rise = (2.0 * r * slope * inner + inner**2) / (np.sqrt(r * r + 2.0 * r * slope * inner + inner**2) + r)
        before = (share * extinction(eye + rise)).sum(-1)
    inside = (height >= 0.0) & (height <= ceiling)
    light = sun_depth(extinction, ceiling, np.clip(height, 0.0, ceiling), sun, radius)
    return float((weight * np.where(inside, extinction(height) * np.exp(-before - light), 0.0)).sum())
