"""Fused twin of `march`; imported only where numba is installed."""

import math

import numpy as np
import torch
from numba import njit
from torch import Tensor

from render.fused import announce_compilation, run_in_threads
from render.media import ExponentialDecay, LinearDecay, Uniform
from render.shafts.air import Air, Constituent
from render.shafts.cube_shadow_map import CubeShadowMap
from render.shafts.fog_bank import FogBank
from render.shafts.fused_banks import Banks, bank_arrays, light_through_banks, measure_banks
from render.shafts.fused_shadows import OPTIONS, Doubles, Floats, Line, lamp_line, lamp_share, sun_line, sun_share
from render.shafts.lights import Lighting
from render.shafts.march import ShadowLooks
from render.shafts.rays import ViewRays
from render.shafts.shadow_map import ShadowMap

CHUNK = 1 << 10
"""Rays of one call."""


loop = njit(**OPTIONS)

KINDS = {Uniform: 0.0, LinearDecay: 1.0, ExponentialDecay: 2.0}
"""Numbers of the profiles."""

BANK = 3.0
"""Number of a bank of fog, whose depths are not those of a layer."""


@loop
def _moment(x: float) -> float:
    """(1 - exp(-x)) / x for x of at least 0; the series is exact to 1e-11 where it is used."""
    if x < 0.06:
        return 1.0 - x * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x / 720.0))))
    return (1.0 - np.exp(-x)) / x


@loop
def _mean_exponential(first: float, last: float) -> float:
    """As `exponential_mean`."""
    low = min(first, last)
    return 0.0 if low > 700.0 else np.exp(-low) * _moment(abs(last - first))


@loop
def _arc(x: float) -> float:
    """atan(x) / x for x of at least 0; the series is exact to 1e-9 where it is used."""
    if x < 0.15:
        y = x * x
        return 1.0 - y * (1.0 / 3.0 - y * (1.0 / 5.0 - y * (1.0 / 7.0 - y / 9.0)))
    return np.arctan(x) / x


@loop
def _grey_depth(layers: Doubles, m: int, first: float, last: float, length: float) -> float:
    """Optical depth of a part of a ray between two heights through one layer."""
    kind, extinction, base, top = layers[m, 0], layers[m, 1], layers[m, 2], layers[m, 3]
    low, high = min(first, last), max(first, last)
    if high < base or low > top or extinction == 0.0:
        return 0.0
    inner_low, inner_high = max(low, base), min(high, top)
    part = length
    if low < base or high > top:
        part *= (inner_high - inner_low) / (high - low)
    if kind == 0.0:
        return extinction * part
    if kind == 1.0:
        return extinction * part * (top - 0.5 * (inner_low + inner_high)) / (top - base)
    reference, scale = layers[m, 4], layers[m, 5]
    return extinction * part * np.exp((reference - inner_low) / scale) * _moment((inner_high - inner_low) / scale)


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


@loop
def _phase(asymmetry: float, cosine: float) -> float:
    """Henyey-Greenstein, or Rayleigh where the asymmetry is no number."""
    if np.isnan(asymmetry):
        return 3.0 / (16.0 * np.pi) * (1.0 + cosine * cosine)
    size = abs(asymmetry)
    peak = (1.0 - size) ** 2 + 2.0 * max(size - asymmetry * cosine, 0.0)
    return (1.0 - asymmetry * asymmetry) / (4.0 * np.pi) / (peak * np.sqrt(peak))


@loop
def _brightest_place(closest: Doubles, k: int, begin: float, end: float) -> float:
    """As `brightest_places`."""
    u, w, aside = begin - closest[k, 0], end - closest[k, 0], closest[k, 1]
    near, far = np.sqrt(aside + u * u), np.sqrt(aside + w * w)
    return closest[k, 0] + (u * far + w * near) / (near + far)


@loop
def _share_of_lamp(
    cubes: Floats, closest: Doubles, k: int, line: Line, begin: float, end: float, count: int, halvings: int
) -> float:
    """Lit share of a step; its only look is at the brightest place."""
    if count == 1 and halvings == 0:
        return lamp_share(cubes, k, line, _brightest_place(closest, k, begin, end), 0.0, count, halvings)
    return lamp_share(cubes, k, line, begin, end - begin, count, halvings)


@loop
def _lamp_step(
    lamps: Doubles, closest: Doubles, k: int, layers: Doubles, rays: Floats, n: int, begin: float, end: float,
    greys: Doubles, arriving: Doubles, light: Doubles, share: float,
) -> None:  # fmt: skip
    """Add what one step scatters of one point light.

    A row of `lamps` is its position, intensity, radius and reach; `closest` the place along the ray nearest to it, and the square of h.
    """
    u, w, aside = begin - closest[k, 0], end - closest[k, 0], closest[k, 1]
    middle = _brightest_place(closest, k, begin, end)
    dx = rays[n, 0] + middle * rays[n, 3] - lamps[k, 0]
    dy = rays[n, 1] + middle * rays[n, 4] - lamps[k, 1]
    dz = rays[n, 2] + middle * rays[n, 5] - lamps[k, 2]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    if distance >= lamps[k, 7]:
        return
    cosine = 0.0
    if distance > 0.0:
        cosine = min(max(-(dx * rays[n, 3] + dy * rays[n, 4] + dz * rays[n, 5]) / distance, -1.0), 1.0)
    spread = share * _mean_inverse_square(u, w, aside)
    if lamps[k, 7] < np.inf:
        square = (distance / lamps[k, 7]) * (distance / lamps[k, 7])
        spread *= (1.0 - square * square) * (1.0 - square * square)
    channels, through = len(arriving), 3 * len(layers)
    for c in range(channels):
        weight = depth = 0.0
        for m in range(len(layers)):
            if c == 0:
                greys[len(layers) + m] = layers[m, 9] * _phase(layers[m, 10], cosine) * greys[m]
                greys[2 * len(layers) + m] = _grey_depth(layers, m, lamps[k, 2] + dz, lamps[k, 2], distance)
            weight += greys[len(layers) + m] * layers[m, 6 + c]
            depth += greys[2 * len(layers) + m] * layers[m, 6 + c]
        amount = spread * weight * arriving[c] * np.exp(-depth) * greys[through + c]
        light[c] += lamps[k, 3 + c] * amount
        if channels == 1:
            light[1] += lamps[k, 4] * amount
            light[2] += lamps[k, 5] * amount


@loop
def _mean_inverse_square(first: float, last: float, aside: float) -> float:
    """As `inverse_square_mean`, for a step that has a length."""
    below = aside + first * last
    h = np.sqrt(aside)
    if below > 0.0:
        return _arc(h * (last - first) / below) / below
    return np.arctan2(h * (last - first), below) / (h * (last - first))


Sunlight = tuple[Floats, Doubles, Doubles, Doubles]
"""As of `_sun_arrays`."""
Maps = tuple[Doubles, Floats, Doubles, Floats]
"""Matrix and offset of the sun's map (3, 4), its tops, point lights and their cubes."""
Work = tuple[Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles]
"""Numbers of one ray: depth so far, depth and scattered depth of the step, depths to the sun at its ends, what arrives, greys, closest."""


@loop
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
            greys[m] = _grey_depth(layers, m, low, high, length)
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


@loop
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
        mean = lit * _mean_exponential(before[c] + sun_low[c], before[c] + step[c] + sun_high[c])
        if foggy:
            mean *= arriving[c]
        light[c] += irradiance[c] * source[c] * mean
        if channels == 1:
            light[1] += irradiance[1] * source[0] * mean
            light[2] += irradiance[2] * source[0] * mean
        sun_low[c] = sun_high[c]


@njit(inline="always", **OPTIONS)
def _pass_step(before: Doubles, step: Doubles, arriving: Doubles, lamps: bool) -> float:
    """Pass a step: what of its light reaches the eye if lamps ask, and the depth behind it, the least of whose channels comes back."""
    least = np.inf
    for c in range(len(step)):
        if lamps:
            arriving[c] = _mean_exponential(before[c], before[c] + step[c])
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
    before, step, source, arriving, greys, closest = work[0], work[1], work[2], work[5], work[6], work[7]
    for c in range(3):
        light[c] = 0.0
    before[:] = 0.0
    greys[:] = 1.0  # the last three are what banks leave of a lamp
    low, known, has_sun, foggy = float(rays[n, 2]), False, len(irradiance) > 0, len(banks[2]) > 0
    for k in range(len(lamps)):
        _nearest(lamps, k, rays, n, closest)
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
        least = _pass_step(before, step, arriving, len(lamps) > 0)
        for k in range(len(lamps) if end > begin else 0):
            share = _share_of_lamp(cubes, closest, k, lamp_line(lamps, k, rays, n), begin, end, count, halvings)
            if share > 0.0 and foggy:
                middle = _brightest_place(closest, k, begin, end)
                light_through_banks(banks, layers, k + 2, rays, n, middle, len(step), greys, 3 * len(layers))
            if share > 0.0:
                _lamp_step(lamps, closest, k, layers, rays, n, begin, end, greys, arriving, light, share)
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


@loop
def _nearest(lamps: Doubles, k: int, rays: Floats, n: int, closest: Doubles) -> None:
    """Where along a ray a light is nearest, and the squared distance there plus that of its radius."""
    x, y, z = lamps[k, 0] - rays[n, 0], lamps[k, 1] - rays[n, 1], lamps[k, 2] - rays[n, 2]
    nearest = x * rays[n, 3] + y * rays[n, 4] + z * rays[n, 5]
    x, y, z = x - nearest * rays[n, 3], y - nearest * rays[n, 4], z - nearest * rays[n, 5]
    closest[k, 0], closest[k, 1] = nearest, x * x + y * y + z * z + lamps[k, 6] * lamps[k, 6]


def march_fused(
    air: Air, lighting: Lighting, rays: ViewRays, edges: Tensor, spent: float, looks: ShadowLooks
) -> Tensor:
    """In-scattered light `(ray, channel)`; see `render.shafts.march.march`."""
    announce_compilation("fused_march", _march.stats.cache_path)
    found = torch.zeros(len(rays), 3)
    lines = torch.cat([rays.origin, rays.direction], dim=1).float().contiguous().numpy()
    sun = _sun_arrays(air, lighting, rays)
    maps = (*_map_arrays(lighting), *_lamp_arrays(lighting))
    banks = bank_arrays(air.banks, lighting)
    grey = all(len(set(part.colour)) == 1 for part in air.particles)
    channels, deepest = 1 if grey else 3, math.inf if spent <= 0.0 else -math.log(spent)
    borders, layers, out = edges.contiguous().numpy(), _layer_array(air), found.numpy()

    def work(first: int, last: int) -> None:
        numbers = tuple(np.zeros(channels) for _ in range(6))
        space = (*numbers, np.zeros(3 * len(layers) + 3), np.zeros((len(maps[2]), 2)))
        _march(
            lines, borders, layers, sun, maps, banks, deepest, looks.count, looks.halvings, space, np.zeros(3), out,
            first, last,
        )  # fmt: skip

    run_in_threads(work, len(out), CHUNK)
    return found


def _layer_array(air: Air) -> Doubles:
    """One row for all particles of a kind: kind, extinction, base, top, reference, scale, colour (3), albedo, asymmetry or NaN."""
    rows = np.zeros((len(air.particles), 11))
    for row, part in zip(rows, air.particles, strict=True):
        if isinstance(part, Constituent):
            medium = part.medium
            reference, scale = getattr(medium, "reference", 0.0), getattr(medium, "scale_height", 1.0)
            extinction = getattr(medium, "extinction", 0.0)
            row[:6] = KINDS[type(medium)], extinction, medium.base, medium.top, reference, scale
        elif isinstance(part, FogBank):
            # Its layer is empty: no height lies above the base and below the top.
            row[:4] = BANK, part.extinction, np.inf, -np.inf
        row[6:9], row[9] = part.colour, part.albedo
        row[10] = np.nan if part.phase == "rayleigh" else part.asymmetry
    return rows


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


def _lamp_arrays(lighting: Lighting) -> tuple[Doubles, Floats]:
    """Point lights one a row, and their maps `(light, 6, row, column)`."""
    lamps = np.zeros((len(lighting.points), 8))
    sizes = [p.visibility.distances.shape[-1] for p in lighting.points if isinstance(p.visibility, CubeShadowMap)]
    size = max(sizes, default=1)
    cubes = np.full((len(lamps), 6, size, size), np.inf, np.float32)
    for number, point in enumerate(lighting.points):
        light = point.light
        lamps[number] = (*light.position, *light.intensity, light.radius, light.reach)
        if isinstance(point.visibility, CubeShadowMap):
            cubes[number] = point.visibility.distances.numpy()
    return lamps, cubes
