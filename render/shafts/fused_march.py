"""Fused twin of `march`; imported only where numba is installed."""

import math

import numpy as np
import torch
from numba import njit
from torch import Tensor

from render.fused import announce_compilation, run_in_threads
from render.shafts.air import Air
from render.shafts.fused_banks import Banks, bank_arrays, light_through_banks, measure_banks
from render.shafts.fused_lamps import add_lamp_step, find_nearest, lamp_arrays
from render.shafts.fused_layers import BANK, grey_depth, layer_array, mean_exponential
from render.shafts.fused_shadows import OPTIONS, Doubles, Floats, sun_line, sun_share
from render.shafts.lights import Lighting
from render.shafts.march import ShadowLooks
from render.shafts.rays import ViewRays
from render.shafts.shadow_map import ShadowMap

CHUNK = 1 << 10
"""Rays of one call."""

loop = njit(**OPTIONS)
# A call that hands on a dozen arrays costs more than what these compute.
inlined = njit(inline="always", **OPTIONS)


@loop
def _look_up_depth(table: Doubles, lowest: float, spacing: float, height: float, found: Doubles) -> None:
    """As `SunDepthTable.look_up`, into as many channels as `found` has."""
    last = len(table) - 1
    place = min(max((height - lowest) / spacing, 0.0), float(last))
    cell = min(int(place), last - 1)
    share = place - cell
    for c in range(len(found)):
        near, far = table[cell, c], table[cell + 1, c]
        found[c] = max(near, far) if max(near, far) > 1e300 else near + share * (far - near)


Sunlight = tuple[Floats, Doubles, Doubles, Doubles]
"""As of `_sun_arrays`."""
Maps = tuple[Doubles, Floats, Doubles, Floats]
"""Matrix and offset of the sun's map (3, 4), its tops, point lights and their cubes."""
Work = tuple[Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles]
"""Numbers of one ray: depth so far, depth and scattered depth of the step, depths to the sun at its ends, what arrives, greys, closest."""


@inlined
def _measure_step(
    layers: Doubles, phase: Floats, n: int, low: float, high: float, length: float,
    step: Doubles, source: Doubles, greys: Doubles,
) -> None:  # fmt: skip
    """Optical depth of a step by channel and constituent, and the part of it that scatters sunlight into the ray.

    The grey depths of banks are known already.
    """
    # Written out: loops over three channels become vector code, whose preparation takes longer than they do.
    red = green = blue = scattered_red = scattered_green = scattered_blue = 0.0
    for m in range(len(layers)):
        if layers[m, 0] != BANK:
            greys[m] = grey_depth(layers, m, low, high, length)
        grey = greys[m]
        scattered = grey * phase[n, m]
        red += grey * layers[m, 6]
        scattered_red += scattered * layers[m, 6]
        if len(step) == 3:
            green += grey * layers[m, 7]
            scattered_green += scattered * layers[m, 7]
            blue += grey * layers[m, 8]
            scattered_blue += scattered * layers[m, 8]
    step[0], source[0] = red, scattered_red
    if len(step) == 3:
        step[1], source[1], step[2], source[2] = green, scattered_green, blue, scattered_blue


@inlined
def _sun_step(
    sun: Sunlight, banks: Banks, layers: Doubles, rays: Floats, n: int, begin: float, end: float, known: bool,
    lit: float, work: Work, light: Doubles,
) -> None:  # fmt: skip
    """Add the sunlight of one step; `known` if the depth to the sun at its beginning is that at the end of the last one."""
    table, lowest, spacing, irradiance = sun[1], sun[2][0], sun[2][1], sun[3]
    before, step, source, sun_low, sun_high, arriving = work[0], work[1], work[2], work[3], work[4], work[5]
    if not known:
        _look_up_depth(table, lowest, spacing, float(rays[n, 2]) + float(rays[n, 5]) * begin, sun_low)
    _look_up_depth(table, lowest, spacing, float(rays[n, 2]) + float(rays[n, 5]) * end, sun_high)
    channels, foggy = len(step), len(banks[2]) > 0
    if foggy:
        light_through_banks(banks, layers, 1, rays, n, 0.5 * (begin + end), channels, arriving, 0)
    for c in range(channels):
        mean = lit * mean_exponential(before[c] + sun_low[c], before[c] + step[c] + sun_high[c])
        if foggy:
            mean *= arriving[c]
        light[c] += irradiance[c] * source[c] * mean
        if channels == 1:
            light[1] += irradiance[1] * source[0] * mean
            light[2] += irradiance[2] * source[0] * mean
        sun_low[c] = sun_high[c]


@inlined
def _pass_step(before: Doubles, step: Doubles) -> float:
    """Pass a step: the depth behind it, the least of whose channels comes back."""
    least = np.inf
    for c in range(len(step)):
        before[c] += step[c]
        least = min(least, before[c])
    return least


@loop
def _march_ray(
    rays: Floats, edges: Floats, n: int, layers: Doubles, sun: Sunlight, maps: Maps, banks: Banks,
    deepest: float, count: int, halvings: int, work: Work, light: Doubles,
) -> None:  # fmt: skip
    """All steps of one ray."""
    phase, irradiance = sun[0], sun[3]
    frame, tops, lamps, cubes = maps
    before, step, source, greys, closest = work[0], work[1], work[2], work[6], work[7]
    for c in range(3):
        light[c] = 0.0
    before[:] = 0.0
    greys[:] = 1.0  # the last three are what banks leave of a lamp
    low, known, has_sun, foggy = float(rays[n, 2]), False, len(irradiance) > 0, len(banks[2]) > 0
    for k in range(len(lamps)):
        find_nearest(lamps, k, rays, n, float(edges[n, 0]), closest)
    line = sun_line(frame, rays, n)
    for i in range(edges.shape[1] - 1):
        begin, end = float(edges[n, i]), float(edges[n, i + 1])
        high = float(rays[n, 2]) + float(rays[n, 5]) * end
        if foggy:
            measure_banks(banks, layers, rays, n, begin, end, greys)
        _measure_step(layers, phase, n, low, high, end - begin, step, source, greys)
        lit = 0.0
        if has_sun and end > begin:
            lit = sun_share(tops, line, begin, end - begin, count, halvings)
        if lit > 0.0:
            _sun_step(sun, banks, layers, rays, n, begin, end, known, lit, work, light)
        known = lit > 0.0
        for k in range(len(lamps) if end > begin else 0):
            add_lamp_step(lamps, cubes, closest, k, layers, banks, rays, n, begin, end, count, halvings, work, light)
        least = _pass_step(before, step)
        low = high
        if least > deepest:
            break


@loop
def _march(
    rays: Floats, edges: Floats, layers: Doubles, sun: Sunlight, maps: Maps, banks: Banks, deepest: float, count: int,
    halvings: int, work: Work, light: Doubles, found: Floats, first: int, last: int,
) -> None:  # fmt: skip
    """The rays from `first` to `last`; one channel stands for all where the air is grey."""
    for n in range(first, last):
        _march_ray(rays, edges, n, layers, sun, maps, banks, deepest, count, halvings, work, light)
        for c in range(3):
            found[n, c] = light[c]


def march_fused(
    air: Air, lighting: Lighting, rays: ViewRays, edges: Tensor, spent: float, looks: ShadowLooks
) -> Tensor:
    """In-scattered light `(ray, channel)`; see `render.shafts.march.march`."""
    announce_compilation("fused_march", _march.stats.cache_path)
    found = torch.zeros(len(rays), 3)
    lines = torch.cat([rays.origin, rays.direction], dim=1).float().contiguous().numpy()
    sun = _sun_arrays(air, lighting, rays)
    maps = (*_map_arrays(lighting), *lamp_arrays(lighting))
    banks = bank_arrays(air.banks, lighting)
    grey = all(len(set(part.colour)) == 1 for part in air.particles)
    channels, deepest = 1 if grey else 3, math.inf if spent <= 0.0 else -math.log(spent)
    borders, layers, out = edges.contiguous().numpy(), layer_array(air), found.numpy()

    def work(first: int, last: int) -> None:
        numbers = tuple(np.zeros(channels) for _ in range(6))
        space = (*numbers, np.zeros(3 * len(layers) + 3), np.zeros((len(maps[2]), 3)))
        _march(
            lines, borders, layers, sun, maps, banks, deepest, looks.count, looks.halvings, space, np.zeros(3), out,
            first, last,
        )  # fmt: skip

    run_in_threads(work, len(out), CHUNK)
    return found


def _sun_arrays(air: Air, lighting: Lighting, rays: ViewRays) -> tuple[Floats, Doubles, Doubles, Doubles]:
    """Albedo times phase function `(ray, constituent)`, table of depths, its heights, and the irradiance: empty without a sun."""
    sun = lighting.sun
    if sun is None:
        phase = np.zeros((len(rays), len(air.particles) + 1), np.float32)
        return phase, np.zeros((2, 3)), np.array([0.0, 1.0]), np.zeros(0)
    cosine = (rays.direction @ rays.direction.new_tensor(sun.light.direction)).clamp(-1.0, 1.0)
    phases = [part.albedo * part.evaluate_phase(cosine) for part in air.particles]
    phase = torch.stack([*phases, torch.zeros_like(cosine)], dim=1).contiguous().numpy()
    heights = np.array([sun.depth.lowest, sun.depth.spacing])
    return phase, sun.depth.depths.numpy(), heights, np.array(sun.light.irradiance)


def _map_arrays(lighting: Lighting) -> tuple[Doubles, Floats]:
    """Matrix and offset `(3, 4)` from positions to places in the sun's map, and its tops; or a map in which everything is lit."""
    seen = None if lighting.sun is None else lighting.sun.visibility
    if not isinstance(seen, ShadowMap):
        return np.eye(3, 4), np.full((1, 1), -np.inf, np.float32)
    scale = np.array([seen.texel, seen.texel, 1.0])[:, None]
    offset = np.append(seen.lower.double().numpy(), 0.0)[:, None]
    return np.hstack([seen.axes.double().numpy(), -offset]) / scale, seen.tops.numpy()
