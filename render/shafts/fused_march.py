"""Fused twin of `march`; imported only where numba is installed."""

import math
from pathlib import Path

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from render.fused import announce_compilation, run_in_threads
from render.media import ExponentialDecay, LinearDecay, Uniform
from render.shafts.air import Air
from render.shafts.cube_shadow_map import CubeShadowMap
from render.shafts.lights import Lighting
from render.shafts.rays import ViewRays
from render.shafts.shadow_map import ShadowMap

CHUNK = 1 << 10
"""Rays of one call."""

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]

KINDS = {Uniform: 0.0, LinearDecay: 1.0, ExponentialDecay: 2.0}
"""Numbers of the profiles."""

HALF = np.float32(0.5)


@njit(nogil=True, cache=True, error_model="numpy")
def _moment(x: float) -> float:
    """(1 - exp(-x)) / x for x of at least 0; the series is exact to 1e-11 where it is used."""
    if x < 0.06:
        return 1.0 - x * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x / 720.0))))
    return (1.0 - np.exp(-x)) / x


@njit(nogil=True, cache=True, error_model="numpy")
def _mean_exponential(first: float, last: float) -> float:
    """As `exponential_mean`."""
    low = min(first, last)
    return 0.0 if low > 700.0 else np.exp(-low) * _moment(abs(last - first))


@njit(nogil=True, cache=True, error_model="numpy")
def _arc(x: float) -> float:
    """atan(x) / x for x of at least 0; the series is exact to 1e-9 where it is used."""
    if x < 0.15:
        y = x * x
        return 1.0 - y * (1.0 / 3.0 - y * (1.0 / 5.0 - y * (1.0 / 7.0 - y / 9.0)))
    return np.arctan(x) / x


@njit(nogil=True, cache=True, error_model="numpy")
def _grey_depth(layers: Doubles, m: int, first: float, last: float, length: float) -> float:
    """Optical depth of a part of a ray between two heights through one layer."""
    kind, extinction, base, top = layers[m, 0], layers[m, 1], layers[m, 2], layers[m, 3]
    low, high = min(first, last), max(first, last)
    if high < base or low > top or extinction == 0.0:
        return 0.0
    inner_low, inner_high = max(low, base), min(high, top)
    part = length if high == low else length * ((inner_high - inner_low) / (high - low))
    if kind == 0.0:
        return extinction * part
    if kind == 1.0:
        return extinction * part * (top - 0.5 * (inner_low + inner_high)) / (top - base)
    reference, scale = layers[m, 4], layers[m, 5]
    return extinction * part * np.exp((reference - inner_low) / scale) * _moment((inner_high - inner_low) / scale)


@njit(nogil=True, cache=True, error_model="numpy")
def _look_up_depth(table: Doubles, lowest: float, spacing: float, height: float, found: Doubles) -> None:
    """As `SunDepthTable.look_up`, into as many channels as `found` has."""
    last = len(table) - 1
    place = min(max((height - lowest) / spacing, 0.0), float(last))
    cell = min(int(place), last - 1)
    share = place - cell
    for c in range(len(found)):
        near, far = table[cell, c], table[cell + 1, c]
        found[c] = max(near, far) if max(near, far) > 1e300 else near + share * (far - near)


@njit(nogil=True, cache=True, error_model="numpy")
def _sees_sun(axes: Floats, lower: Floats, texel: float, tops: Floats, x: float, y: float, z: float) -> bool:
    """As `ShadowMap.look_up_lit`, for one point."""
    u = (x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2] - lower[0]) / texel
    v = (x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2] - lower[1]) / texel
    if not (u >= 0.0 and v >= 0.0 and u < tops.shape[1] and v < tops.shape[0]):
        return True
    return x * axes[2, 0] + y * axes[2, 1] + z * axes[2, 2] >= tops[int(v), int(u)]


@njit(nogil=True, cache=True, error_model="numpy")
def _sees_lamp(cubes: Floats, k: int, dx: float, dy: float, dz: float, distance: float) -> bool:
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
    return distance <= cubes[k, 2 * axis + (1 if main < 0.0 else 0), row, column]


@njit(nogil=True, cache=True, error_model="numpy")
def _phase(asymmetry: float, cosine: float) -> float:
    """Henyey-Greenstein, or Rayleigh where the asymmetry is no number."""
    if np.isnan(asymmetry):
        return 3.0 / (16.0 * np.pi) * (1.0 + cosine * cosine)
    size = abs(asymmetry)
    peak = (1.0 - size) ** 2 + 2.0 * max(size - asymmetry * cosine, 0.0)
    return (1.0 - asymmetry * asymmetry) / (4.0 * np.pi) / (peak * np.sqrt(peak))


@njit(nogil=True, cache=True, error_model="numpy")
def _lamp_step(
    lamps: Doubles, closest: Doubles, cubes: Floats, k: int, layers: Doubles, rays: Floats, n: int, begin: float, end: float,
    greys: Doubles, arriving: Doubles, light: Doubles,
) -> None:  # fmt: skip
    """Add what one step scatters of one point light.

    A row of `lamps` is its position, intensity, radius and reach; `closest` the place along the ray nearest to it, and the square of h.
    """
    middle = 0.5 * (begin + end)
    dx = rays[n, 0] + middle * rays[n, 3] - lamps[k, 0]
    dy = rays[n, 1] + middle * rays[n, 4] - lamps[k, 1]
    dz = rays[n, 2] + middle * rays[n, 5] - lamps[k, 2]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    if distance >= lamps[k, 7] or not _sees_lamp(cubes, k, dx, dy, dz, distance):
        return
    cosine = 0.0
    if distance > 0.0:
        cosine = min(max(-(dx * rays[n, 3] + dy * rays[n, 4] + dz * rays[n, 5]) / distance, -1.0), 1.0)
    u, w, aside = begin - closest[k, 0], end - closest[k, 0], closest[k, 1]
    spread = _mean_inverse_square(u, w, aside)
    if lamps[k, 7] < np.inf:
        share = (distance / lamps[k, 7]) * (distance / lamps[k, 7])
        spread *= (1.0 - share * share) * (1.0 - share * share)
    channels = len(arriving)
    for c in range(channels):
        weight = depth = 0.0
        for m in range(len(layers)):
            if c == 0:
                greys[len(layers) + m] = layers[m, 9] * _phase(layers[m, 10], cosine) * greys[m]
                greys[2 * len(layers) + m] = _grey_depth(layers, m, lamps[k, 2] + dz, lamps[k, 2], distance)
            weight += greys[len(layers) + m] * layers[m, 6 + c]
            depth += greys[2 * len(layers) + m] * layers[m, 6 + c]
        amount = spread * weight * arriving[c] * np.exp(-depth)
        light[c] += lamps[k, 3 + c] * amount
        if channels == 1:
            light[1] += lamps[k, 4] * amount
            light[2] += lamps[k, 5] * amount


@njit(nogil=True, cache=True, error_model="numpy")
def _mean_inverse_square(first: float, last: float, aside: float) -> float:
    """As `inverse_square_mean`, for a step that has a length."""
    below = aside + first * last
    h = np.sqrt(aside)
    if below > 0.0:
        return _arc(h * (last - first) / below) / below
    return np.arctan2(h * (last - first), below) / (h * (last - first))


@njit(nogil=True, cache=True, error_model="numpy")
def _march(
    rays: Floats, edges: Floats, layers: Doubles, channels: int,
    sun_phase: Floats, table: Doubles, heights: Doubles,
    axes: Floats, lower: Floats, texel: float, tops: Floats, irradiance: Doubles,
    lamps: Doubles, cubes: Floats, spent: float, found: Floats, first: int, last: int,
) -> None:  # fmt: skip
    """All steps of the rays from `first` to `last`; one channel stands for all where the air is grey."""
    count = len(layers)
    light, greys, closest = np.zeros(3), np.zeros(3 * count), np.zeros((len(lamps), 2))
    before, step, source, arriving = np.zeros(channels), np.zeros(channels), np.zeros(channels), np.zeros(channels)
    sun_low, sun_high = np.zeros(channels), np.zeros(channels)
    for n in range(first, last):
        light[:] = 0.0
        before[:] = 0.0
        low, known = float(rays[n, 2]), False
        for k in range(len(lamps)):
            _nearest(lamps, k, rays, n, closest)
        for i in range(edges.shape[1] - 1):
            begin, end = edges[n, i], edges[n, i + 1]
            if not end > begin:
                continue
            high = float(rays[n, 2]) + float(rays[n, 5]) * float(end)
            middle = HALF * (end + begin)
            x, y, z = (
                rays[n, 0] + middle * rays[n, 3],
                rays[n, 1] + middle * rays[n, 4],
                rays[n, 2] + middle * rays[n, 5],
            )
            lit = len(irradiance) > 0 and _sees_sun(axes, lower, texel, tops, x, y, z)
            step[:] = 0.0
            source[:] = 0.0
            for m in range(count):
                grey = _grey_depth(layers, m, low, high, float(end - begin))
                greys[m] = grey
                for c in range(channels):
                    step[c] += grey * layers[m, 6 + c]
                    source[c] += grey * layers[m, 6 + c] * sun_phase[n, m]
            if lit:
                if not known:
                    _look_up_depth(table, heights[0], heights[1], low, sun_low)
                _look_up_depth(table, heights[0], heights[1], high, sun_high)
                for c in range(channels):
                    mean = _mean_exponential(before[c] + sun_low[c], before[c] + step[c] + sun_high[c])
                    light[c] += irradiance[c] * source[c] * mean
                    if channels == 1:
                        light[1] += irradiance[1] * source[0] * mean
                        light[2] += irradiance[2] * source[0] * mean
                    sun_low[c] = sun_high[c]
            known = lit
            if len(lamps) > 0:
                for c in range(channels):
                    arriving[c] = _mean_exponential(before[c], before[c] + step[c])
                for k in range(len(lamps)):
                    _lamp_step(
                        lamps, closest, cubes, k, layers, rays, n, float(begin), float(end), greys, arriving, light
                    )
            least = np.inf
            for c in range(channels):
                before[c] += step[c]
                least = min(least, before[c])
            low = high
            if least > spent:
                break
        for c in range(3):
            found[n, c] = light[c]


@njit(nogil=True, cache=True, error_model="numpy")
def _nearest(lamps: Doubles, k: int, rays: Floats, n: int, closest: Doubles) -> None:
    """Where along a ray a light is nearest, and the squared distance there plus that of its radius."""
    x, y, z = lamps[k, 0] - rays[n, 0], lamps[k, 1] - rays[n, 1], lamps[k, 2] - rays[n, 2]
    nearest = x * rays[n, 3] + y * rays[n, 4] + z * rays[n, 5]
    x, y, z = x - nearest * rays[n, 3], y - nearest * rays[n, 4], z - nearest * rays[n, 5]
    closest[k, 0], closest[k, 1] = nearest, x * x + y * y + z * z + lamps[k, 6] * lamps[k, 6]


def march_fused(air: Air, lighting: Lighting, rays: ViewRays, edges: Tensor, spent: float) -> Tensor:
    """In-scattered light `(ray, channel)`; see `render.shafts.march.march`."""
    announce_compilation("fused_march", str(Path(__file__).parent / "__pycache__"))
    found = torch.zeros(len(rays), 3)
    lines = torch.cat([rays.origin, rays.direction], dim=1).float().contiguous().numpy()
    sun, lamps = _sun_arrays(air, lighting, rays), _lamp_arrays(lighting)
    grey = all(len(set(part.colour)) == 1 for part in air.constituents)
    arrays = (lines, edges.contiguous().numpy(), _layer_array(air), 1 if grey else 3, *sun, *lamps)
    out, deepest = found.numpy(), math.inf if spent <= 0.0 else -math.log(spent)
    run_in_threads(lambda first, last: _march(*arrays, deepest, out, first, last), len(out), CHUNK)
    return found


def _layer_array(air: Air) -> Doubles:
    """One row a constituent: kind, extinction, base, top, reference, scale, colour (3), albedo, asymmetry or NaN."""
    rows = np.zeros((len(air.constituents), 11))
    for row, part in zip(rows, air.constituents, strict=True):
        medium = part.medium
        reference, scale = getattr(medium, "reference", 0.0), getattr(medium, "scale_height", 1.0)
        row[:6] = (KINDS[type(medium)], getattr(medium, "extinction", 0.0), medium.base, medium.top, reference, scale)
        row[6:9], row[9] = part.colour, part.albedo
        row[10] = np.nan if part.phase == "rayleigh" else part.asymmetry
    return rows


def _sun_arrays(
    air: Air, lighting: Lighting, rays: ViewRays
) -> tuple[Floats, Doubles, Doubles, Floats, Floats, float, Floats, Doubles]:
    """Phase functions `(ray, constituent)`, table of depths, its heights, the map's arrays, and the irradiance, empty without a sun."""
    sun = lighting.sun
    nowhere = (np.eye(3, dtype=np.float32), np.zeros(2, np.float32), 1.0, np.full((1, 1), -np.inf, np.float32))
    if sun is None:
        phase = np.zeros((len(rays), len(air.constituents)), np.float32)
        return phase, np.zeros((2, 3)), np.array([0.0, 1.0]), *nowhere, np.zeros(0)
    cosine = (rays.direction @ rays.direction.new_tensor(sun.light.direction)).clamp(-1.0, 1.0)
    phases = [part.albedo * part.evaluate_phase(cosine) for part in air.constituents]
    phase = torch.stack([*phases, torch.zeros_like(cosine)], dim=1).contiguous().numpy()
    table, heights = sun.depth.depths.numpy(), np.array([sun.depth.lowest, sun.depth.spacing])
    seen = sun.visibility
    maps = (
        (seen.axes.numpy(), seen.lower.numpy(), seen.texel, seen.tops.numpy())
        if isinstance(seen, ShadowMap)
        else nowhere
    )
    return phase, table, heights, *maps, np.array(sun.light.irradiance)


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
