"""Adaptive quadrature of light in layered fog, in float64 numpy: it knows an extinction at a height and nothing else
of what it tests.

A ray is bisected until the extinction is resolved and the exponent changes by no more than 3 in each panel (panels
that are darker than the brightest by exp(-60) excepted); Gauss-Legendre with 16 nodes then leaves about 1e-14. The
path from every node to the sun is integrated for itself.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray

NODES = 16
GAUSS_X, GAUSS_W = np.polynomial.legendre.leggauss(NODES)
GAUSS_X, GAUSS_W = 0.5 * (GAUSS_X + 1.0), 0.5 * GAUSS_W
# Integrals of the interpolating polynomial from 0 to each node: integrates within a panel.
CUMULATIVE = np.array(
    [
        [
            x
            * np.sum(
                GAUSS_W * np.prod([(x * GAUSS_X - other) / (node - other) for other in np.delete(GAUSS_X, j)], axis=0)
            )
            for j, node in enumerate(GAUSS_X)
        ]
        for x in GAUSS_X
    ]
)
LIGHT_EDGES = np.array([0.0, 1.0, 3.0, 7.0, 13.0, 23.0, 45.0])
"""Panels of the path to the sun through fog that never ends, in units in which it thins out by e."""

DARK, RANGE, MOST_ROUNDS = 60.0, 3.0, 200


@dataclass(frozen=True)
class PlainFog:
    """Layers, one for each configuration: `extinction(height, index)` [1/m] within, borders [m], scale heights [m] or
    infinity.

    Heights are told from where the rays begin, so that a short ray does not vanish in the rounding of its height.
    """

    extinction: Callable[[Array, Array], Array]
    base: Array
    top: Array
    scale_height: Array


@dataclass(frozen=True)
class PlainRays:
    """Rays that begin within or outside the layers: heights [m], slopes, slopes towards the sun, lengths [m] that may be infinite."""

    height: Array
    slope: Array
    sun_slope: Array
    distance: Array


def parts_within(fog: PlainFog, rays: PlainRays) -> tuple[Array, Array]:
    """Distances [m] at which the rays enter and leave the layer, the last one cut where nothing more can be seen."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one = (fog.base - rays.height) / rays.slope
        other = (fog.top - rays.height) / rays.slope
    level = rays.slope == 0.0
    inside = (rays.height >= fog.base) & (rays.height <= fog.top)
    enter = np.where(level, np.where(inside, 0.0, np.inf), np.minimum(one, other))
    leave = np.where(level, np.inf, np.maximum(one, other))
    enter = np.maximum(enter, 0.0)
    leave = np.minimum(leave, rays.distance)
    enter = np.minimum(enter, leave)
    index = np.arange(len(enter))
    start = np.where(np.isfinite(enter), enter, 0.0)
    height = rays.height + rays.slope * start
    here = fog.extinction(np.clip(height, fog.base, fog.top), index)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        rising = 45.0 * fog.scale_height / rays.slope
        # Falling through fog that thickens for ever: where its depth from above is a thousand.
        falling = fog.scale_height / -rays.slope * np.log1p(1e3 * -rays.slope / (here * fog.scale_height))
        flat = 800.0 / here
    cut = np.where(rays.slope > 0.0, rising, np.where(rays.slope < 0.0, falling, flat))
    leave = np.where(np.isinf(leave), start + np.where(here > 0.0, cut, 0.0), leave)
    return start, np.where(np.isfinite(enter), leave, start)


def light_depth(fog: PlainFog, height: Array, sun_slope: Array, index: Array) -> Array:
    """Optical depth [1] from heights to the sun, each by quadrature along its own path; any shape."""
    target = np.where(sun_slope > 0.0, fog.top[index], fog.base[index])
    with np.errstate(divide="ignore", invalid="ignore"):
        path = (target - height) / sun_slope
        unit = np.where(np.isinf(path) & (sun_slope > 0.0), fog.scale_height[index] / sun_slope, path / LIGHT_EDGES[-1])
    endless = ~np.isfinite(unit)
    unit = np.where(endless, 0.0, unit)
    depth = np.zeros_like(height)
    for low, high in itertools.pairwise(LIGHT_EDGES):
        for x, w in zip(GAUSS_X, GAUSS_W, strict=True):
            s = unit * (low + (high - low) * x)
            depth += w * (high - low) * unit * fog.extinction(height + sun_slope * s, index)
    return np.where(endless, np.inf, depth)


@dataclass
class _Panels:
    """A mesh over all rays, ordered by ray and distance."""

    ray: Array
    low: Array
    high: Array

    def nodes(self) -> Array:
        return self.low[:, None] + (self.high - self.low)[:, None] * GAUSS_X


def _extinction(fog: PlainFog, rays: PlainRays, panels: _Panels) -> Array:
    height = rays.height[panels.ray, None] + rays.slope[panels.ray, None] * panels.nodes()
    return fog.extinction(height, np.broadcast_to(panels.ray[:, None], height.shape))


def _depth_before(panels: _Panels, depth: Array, count: int) -> Array:
    """Optical depth from the beginning of each ray to each panel, summed ray by ray so that none disturbs another."""
    first = np.searchsorted(panels.ray, np.arange(count))
    place = np.arange(len(panels.ray)) - first[panels.ray]
    table = np.zeros((count, int(place.max()) + 2))
    table[panels.ray, place + 1] = depth
    return np.cumsum(table, axis=1)[panels.ray, place]


def _refine(panels: _Panels, split: Array) -> _Panels:
    middle = 0.5 * (panels.low + panels.high)
    ray = np.concatenate([panels.ray[~split], panels.ray[split], panels.ray[split]])
    low = np.concatenate([panels.low[~split], panels.low[split], middle[split]])
    high = np.concatenate([panels.high[~split], middle[split], panels.high[split]])
    order = np.lexsort((low, ray))
    return _Panels(ray[order], low[order], high[order])


def _mesh(fog: PlainFog, rays: PlainRays) -> _Panels:
    start, end = parts_within(fog, rays)
    panels = _Panels(np.arange(len(start)), start, end)
    for _ in range(MOST_ROUNDS):
        size = panels.high - panels.low
        along = _extinction(fog, rays, panels)
        depth = size * (along @ GAUSS_W)
        before = _depth_before(panels, depth, len(start))
        with np.errstate(invalid="ignore"):
            light = [
                light_depth(
                    fog, rays.height[panels.ray] + rays.slope[panels.ray] * t, rays.sun_slope[panels.ray], panels.ray
                )
                for t in (panels.low, panels.high)
            ]
            lit = np.isfinite(light[0] + light[1])
            low = before + np.where(lit, light[0], 0.0)
            high = before + depth + np.where(lit, light[1], 0.0)
            brightest = np.full(len(start), np.inf)
            np.minimum.at(brightest, panels.ray, np.minimum(low, high))
            seen = np.minimum(low, high) <= brightest[panels.ray] + DARK
            ranges = np.abs(high - low)
        with np.errstate(divide="ignore", invalid="ignore"):
            rough = np.abs(rays.slope[panels.ray]) * size / fog.scale_height[panels.ray] > RANGE
        split = (seen & ((ranges > RANGE) | rough)) & (size > 1e-14 * panels.high)
        if not split.any():
            return panels
        panels = _refine(panels, split)
    raise RuntimeError("the mesh does not converge")


def integrate_fog(fog: PlainFog, rays: PlainRays) -> tuple[Array, Array]:
    """Optical depth of each ray within the fog, and the sunlight scattered once into it."""
    panels = _mesh(fog, rays)
    size = panels.high - panels.low
    along = _extinction(fog, rays, panels)
    depth = size * (along @ GAUSS_W)
    count = len(rays.height)
    before = _depth_before(panels, depth, count)
    # Far below exp(-60) the mesh is left coarse, and interpolated depths may swing below what they begin with.
    within = before[:, None] + np.maximum(size[:, None] * (along @ CUMULATIVE.T), 0.0)
    height = rays.height[panels.ray, None] + rays.slope[panels.ray, None] * panels.nodes()
    index = np.broadcast_to(panels.ray[:, None], height.shape)
    light = light_depth(fog, height, np.broadcast_to(rays.sun_slope[panels.ray, None], height.shape), index)
    filled = (size > 0.0)[:, None]
    part = size * (np.where(filled, along * np.exp(-np.where(filled, within + light, 0.0)), 0.0) @ GAUSS_W)
    scattered, total = np.zeros(count), np.zeros(count)
    np.add.at(scattered, panels.ray, part)
    np.add.at(total, panels.ray, depth)
    return total, scattered
