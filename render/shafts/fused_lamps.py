"""Point lights in the fused march; imported only where numba is installed."""

import numpy as np
from numba import njit

from render.shafts.cube_shadow_map import CubeShadowMap
from render.shafts.fused_banks import Banks, light_through_banks
from render.shafts.fused_layers import BANK, evaluate_phase, grey_depth, grey_extinction, moment
from render.shafts.fused_shadows import OPTIONS, Doubles, Floats, lamp_line, lamp_share, sees_lamp
from render.shafts.lights import Lighting

loop = njit(**OPTIONS)
# Calls that hand on a dozen arrays cost more than what these two compute.
inlined = njit(inline="always", **OPTIONS)

Work = tuple[Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles]
"""Numbers of one ray: depth so far, depth and scattered depth of the step, depths to the sun at its ends, what banks leave of the sun,
greys, closest. Of greys and particles: depth of the step, scattering, depth to a lamp; then what banks leave of that lamp by channel."""


@loop
def find_nearest(lamps: Doubles, k: int, rays: Floats, n: int, begin: float, closest: Doubles) -> None:
    """Where along a ray a light is nearest, the distance there with that of its radius, and the same where the ray begins."""
    x, y, z = lamps[k, 0] - rays[n, 0], lamps[k, 1] - rays[n, 1], lamps[k, 2] - rays[n, 2]
    nearest = x * rays[n, 3] + y * rays[n, 4] + z * rays[n, 5]
    x, y, z = x - nearest * rays[n, 3], y - nearest * rays[n, 4], z - nearest * rays[n, 5]
    aside, along = x * x + y * y + z * z + lamps[k, 6] * lamps[k, 6], begin - nearest
    closest[k, 0], closest[k, 1], closest[k, 2] = nearest, np.sqrt(aside), np.sqrt(aside + along * along)


@loop
def arc(x: float) -> float:
    """atan(x) / x for x of at least 0; the series is exact to 1e-9 where it is used."""
    if x < 0.15:
        y = x * x
        return 1.0 - y * (1.0 / 3.0 - y * (1.0 / 5.0 - y * (1.0 / 7.0 - y * (1.0 / 9.0))))
    return np.arctan(x) / x


@loop
def angle_of_step(first: float, last: float, h: float) -> float:
    """Angle [rad] of a step that has a length, at a lamp at a distance h beside the ray; its ends are counted from the nearest place."""
    below, across = h * h + first * last, h * (last - first)
    if below > 0.0:
        slope = across / below
        return slope * arc(slope)
    return np.arctan2(across, below)


@inlined
def _scatter(
    lamps: Doubles, k: int, layers: Doubles, spread: float, cosine: float, height: float, distance: float, length: float,
    before: float, work: Work, light: Doubles,
) -> None:  # fmt: skip
    """Add the light of a step by channel, from the middle of its angle, which is `before` behind its beginning."""
    passed, step, greys = work[0], work[1], work[6]
    share = before / length
    run = before * cosine / distance if distance > 0.0 else 0.0
    for c in range(len(step)):
        weight = depth = 0.0
        for m in range(len(layers)):
            if c == 0:
                # The density of a bank is that of the step.
                density = greys[m] / length if layers[m, 0] == BANK else grey_extinction(layers, m, height)
                greys[len(layers) + m] = layers[m, 9] * evaluate_phase(layers[m, 10], cosine) * density
                greys[2 * len(layers) + m] = grey_depth(layers, m, height, lamps[k, 2], distance)
            weight += greys[len(layers) + m] * layers[m, 6 + c]
            depth += greys[2 * len(layers) + m] * layers[m, 6 + c]
        inside = share * step[c]
        half = min(max(inside - run * depth, 0.0), inside + depth)
        amount = spread * weight * np.exp(half - (passed[c] + inside + depth)) * moment(2.0 * half)
        amount *= greys[3 * len(layers) + c]
        light[c] += lamps[k, 3 + c] * amount
        if len(step) == 1:
            light[1] += lamps[k, 4] * amount
            light[2] += lamps[k, 5] * amount


@inlined
def add_lamp_step(
    lamps: Doubles, cubes: Floats, closest: Doubles, k: int, layers: Doubles, banks: Banks, rays: Floats, n: int,
    begin: float, end: float, count: int, halvings: int, work: Work, light: Doubles,
) -> None:  # fmt: skip
    """Add what one step scatters of one point light.

    A row of `lamps` is its position, intensity, radius and reach; `closest` as of `find_nearest`, the last of it being carried from
    step to step.
    """
    nearest, h, near = closest[k, 0], closest[k, 1], closest[k, 2]
    first, last = begin - nearest, end - nearest
    far = np.sqrt(h * h + last * last)
    closest[k, 2] = far
    middle = (first * far + last * near) / (near + far)
    line = lamp_line(lamps, k, rays, n, nearest)
    dx, dy, dz = line[0] + middle * line[3], line[1] + middle * line[4], line[2] + middle * line[5]
    square = dx * dx + dy * dy + dz * dz
    if square >= lamps[k, 7] * lamps[k, 7]:
        return
    if count == 1 and halvings == 0 and not sees_lamp(cubes, k, dx, dy, dz, 1.0):
        return
    spread = angle = angle_of_step(first, last, h)
    if count > 1 or halvings > 0:
        spread *= lamp_share(cubes, k, line, h, first / near, h / near, angle, count, halvings)
        if spread == 0.0:
            return
    distance, spread = np.sqrt(square), spread / h
    cosine = min(max(-middle / distance, -1.0), 1.0) if distance > 0.0 else 0.0
    if lamps[k, 7] < np.inf:
        square /= lamps[k, 7] * lamps[k, 7]
        spread *= (1.0 - square * square) * (1.0 - square * square)
    if len(banks[2]) > 0:
        light_through_banks(banks, layers, k + 2, rays, n, nearest + middle, len(work[1]), work[6], 3 * len(layers))
    height, length = lamps[k, 2] + dz, end - begin
    _scatter(lamps, k, layers, spread, cosine, height, distance, length, middle - first, work, light)


def lamp_arrays(lighting: Lighting) -> tuple[Doubles, Floats]:
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
