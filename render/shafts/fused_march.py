"""Fused twin of `march`; imported only where numba is installed."""

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
    """(1 - exp(-x)) / x for x of at least 0; the series is exact to 1e-12 where it is used."""
    if x < 0.03:
        return 1.0 - x * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x / 720.0))))
    return (1.0 - np.exp(-x)) / x


@njit(nogil=True, cache=True, error_model="numpy")
def _mean_exponential(first: float, last: float) -> float:
    """As `exponential_mean`."""
    low = min(first, last)
    return 0.0 if np.isinf(low) or low > 700.0 else np.exp(-low) * _moment(abs(last - first))


@njit(nogil=True, cache=True, error_model="numpy")
def _grey_depth(layer: Doubles, first: float, last: float, length: float) -> float:
    """Optical depth of a part of a ray between two heights through one layer."""
    kind, extinction, base, top, reference, scale = layer[0], layer[1], layer[2], layer[3], layer[4], layer[5]
    low, high = min(first, last), max(first, last)
    if high < base or low > top or extinction == 0.0:
        return 0.0
    inner_low, inner_high = max(low, base), min(high, top)
    part = length if high == low else length * ((inner_high - inner_low) / (high - low))
    if kind == 0.0:
        return extinction * part
    if kind == 1.0:
        return extinction * part * (top - 0.5 * (inner_low + inner_high)) / (top - base)
    return extinction * part * np.exp((reference - inner_low) / scale) * _moment((inner_high - inner_low) / scale)


@njit(nogil=True, cache=True, error_model="numpy")
def _sun_depth(table: Doubles, lowest: float, spacing: float, height: float, channel: int) -> float:
    """As `SunDepthTable.look_up`."""
    last = len(table) - 1
    place = min(max((height - lowest) / spacing, 0.0), float(last))
    cell = min(int(place), last - 1)
    near, far = table[cell, channel], table[cell + 1, channel]
    if np.isinf(near) or np.isinf(far):
        return max(near, far)
    return near + (place - cell) * (far - near)


@njit(nogil=True, cache=True, error_model="numpy")
def _sees_sun(axes: Floats, lower: Floats, texel: float, tops: Floats, x: float, y: float, z: float) -> bool:
    """As `ShadowMap.look_up_lit`, for one point."""
    u = (x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2] - lower[0]) / texel
    v = (x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2] - lower[1]) / texel
    if not (u >= 0.0 and v >= 0.0 and u < tops.shape[1] and v < tops.shape[0]):
        return True
    return x * axes[2, 0] + y * axes[2, 1] + z * axes[2, 2] >= tops[int(v), int(u)]


@njit(nogil=True, cache=True, error_model="numpy")
def _sees_lamp(cube: Floats, dx: float, dy: float, dz: float, distance: float) -> bool:
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
    size = cube.shape[1]
    column = min(max(int((0.5 + 0.5 * first / abs(main)) * size), 0), size - 1)
    row = min(max(int((0.5 + 0.5 * second / abs(main)) * size), 0), size - 1)
    return distance <= cube[2 * axis + (1 if main < 0.0 else 0), row, column]


@njit(nogil=True, cache=True, error_model="numpy")
def _phase(asymmetry: float, cosine: float) -> float:
    """Henyey-Greenstein, or Rayleigh where the asymmetry is no number."""
    if np.isnan(asymmetry):
        return 3.0 / (16.0 * np.pi) * (1.0 + cosine * cosine)
    size = abs(asymmetry)
    peak = (1.0 - size) ** 2 + 2.0 * max(size - asymmetry * cosine, 0.0)
    return (1.0 - asymmetry * asymmetry) / (4.0 * np.pi) / (peak * np.sqrt(peak))


@njit(nogil=True, cache=True, error_model="numpy")
def _add_lamp(
    lamp: Doubles,
    cube: Floats,
    layers: Doubles,
    ray: Floats,
    begin: float,
    end: float,
    before: Doubles,
    after: Doubles,
    greys: Doubles,
    light: Doubles,
) -> None:
    """Add what one step scatters of one point light; `lamp` is its position, intensity, radius and reach."""
    middle = 0.5 * (begin + end)
    dx = ray[0] + middle * ray[3] - lamp[0]
    dy = ray[1] + middle * ray[4] - lamp[1]
    dz = ray[2] + middle * ray[5] - lamp[2]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    if distance >= lamp[7] or not _sees_lamp(cube, dx, dy, dz, distance):
        return
    cosine = 0.0
    if distance > 0.0:
        cosine = min(max(-(dx * ray[3] + dy * ray[4] + dz * ray[5]) / distance, -1.0), 1.0)
    ox, oy, oz = lamp[0] - ray[0], lamp[1] - ray[1], lamp[2] - ray[2]
    nearest = ox * ray[3] + oy * ray[4] + oz * ray[5]
    ox, oy, oz = ox - nearest * ray[3], oy - nearest * ray[4], oz - nearest * ray[5]
    aside = ox * ox + oy * oy + oz * oz + lamp[6] * lamp[6]
    h, u, w = np.sqrt(aside), begin - nearest, end - nearest
    spread = np.arctan2(h * (w - u), aside + u * w) / (h * (w - u))
    spread *= (1.0 - (distance / lamp[7]) ** 4) ** 2
    weight_0 = weight_1 = weight_2 = 0.0
    depth_0 = depth_1 = depth_2 = 0.0
    for m in range(len(layers)):
        scattered = layers[m, 9] * _phase(layers[m, 10], cosine) * greys[m]
        weight_0, weight_1, weight_2 = (
            weight_0 + scattered * layers[m, 6],
            weight_1 + scattered * layers[m, 7],
            weight_2 + scattered * layers[m, 8],
        )
        between = _grey_depth(layers[m], lamp[2] + dz, lamp[2], distance)
        depth_0, depth_1, depth_2 = (
            depth_0 + between * layers[m, 6],
            depth_1 + between * layers[m, 7],
            depth_2 + between * layers[m, 8],
        )
    light[0] += lamp[3] * spread * weight_0 * np.exp(-depth_0) * _mean_exponential(before[0], after[0])
    light[1] += lamp[4] * spread * weight_1 * np.exp(-depth_1) * _mean_exponential(before[1], after[1])
    light[2] += lamp[5] * spread * weight_2 * np.exp(-depth_2) * _mean_exponential(before[2], after[2])


@njit(nogil=True, cache=True, error_model="numpy")
def _march(
    rays: Floats,
    edges: Floats,
    layers: Doubles,
    sun_phase: Floats,
    table: Doubles,
    heights: Doubles,
    axes: Floats,
    lower: Floats,
    texel: float,
    tops: Floats,
    irradiance: Doubles,
    lamps: Doubles,
    cubes: Floats,
    spent: float,
    found: Floats,
    first: int,
    last: int,
) -> None:
    count = len(layers)
    before, after, light = np.zeros(3), np.zeros(3), np.zeros(3)
    sun_before, sun_after, source, greys = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(count)
    for n in range(first, last):
        ray = rays[n]
        light[:] = 0.0
        before[:] = 0.0
        low = float(ray[2])
        for c in range(3):
            sun_before[c] = _sun_depth(table, heights[0], heights[1], low, c)
        for i in range(edges.shape[1] - 1):
            begin, end = edges[n, i], edges[n, i + 1]
            high = float(ray[2]) + float(ray[5]) * float(end)
            after[:] = before
            source[:] = 0.0
            for m in range(count):
                greys[m] = _grey_depth(layers[m], low, high, float(end - begin))
                for c in range(3):
                    step = greys[m] * layers[m, 6 + c]
                    after[c] += step
                    source[c] += step * sun_phase[n, m]
            middle = HALF * (end + begin)
            x, y, z = ray[0] + middle * ray[3], ray[1] + middle * ray[4], ray[2] + middle * ray[5]
            lit = len(irradiance) > 0 and _sees_sun(axes, lower, texel, tops, x, y, z)
            for c in range(3):
                sun_after[c] = _sun_depth(table, heights[0], heights[1], high, c)
                if lit and source[c] > 0.0:
                    mean = _mean_exponential(before[c] + sun_before[c], after[c] + sun_after[c])
                    light[c] += irradiance[c] * source[c] * mean
            if end > begin:
                for k in range(len(lamps)):
                    _add_lamp(lamps[k], cubes[k], layers, ray, begin, end, before, after, greys, light)
            before[:] = after
            sun_before[:] = sun_after
            low = high
            if np.exp(-min(before[0], before[1], before[2])) < spent:
                break
        for c in range(3):
            found[n, c] = light[c]


def march_fused(air: Air, lighting: Lighting, rays: ViewRays, edges: Tensor, spent: float) -> Tensor:
    """In-scattered light `(ray, channel)`; see `render.shafts.march.march`."""
    announce_compilation("fused_march", str(Path(__file__).parent / "__pycache__"))
    found = torch.zeros(len(rays), 3)
    lines = torch.cat([rays.origin, rays.direction], dim=1).float().contiguous().numpy()
    sun, lamps = _sun_arrays(air, lighting, rays), _lamp_arrays(lighting)
    arrays = (lines, edges.contiguous().numpy(), _layer_array(air), *sun, *lamps)
    out = found.numpy()
    run_in_threads(lambda first, last: _march(*arrays, spent, out, first, last), len(out), CHUNK)
    return found


def _layer_array(air: Air) -> Doubles:
    """One row a constituent: kind, extinction, base, top, reference, scale, colour (3), albedo, asymmetry or NaN."""
    rows = np.zeros((len(air.constituents), 11))
    for row, part in zip(rows, air.constituents, strict=True):
        medium = part.medium
        reference, scale = getattr(medium, "reference", 0.0), getattr(medium, "scale_height", 1.0)
        row[:6] = (KINDS[type(medium)], medium.extinction, medium.base, medium.top, reference, scale)
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
