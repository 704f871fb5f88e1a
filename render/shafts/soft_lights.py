"""Soft shadows: a light that has a size as several points, each with a shadow of its own.

Ali, Sunar & Kolivand 2017, "Soft bilateral filtering volumetric shadows using cube shadow maps", shift the light; here its places are
spread evenly, by the golden angle. A lamp becomes points on its sphere, each as large as the gaps between them, and the sun becomes points
of its disc. Light is conserved: each has its share of the intensity. The penumbra has as many steps as the light has points.
"""

import math
from dataclasses import replace

from render.camera import Vector
from render.shafts.lights import PointLight, Sun
from render.shafts.shadow_map import light_axes

GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
"""Turn between neighbouring points [rad]."""


def split_lamp(light: PointLight) -> tuple[PointLight, ...]:
    """Points on the sphere of a lamp that together have its intensity; the lamp itself if it is one point."""
    count = light.shadow_points
    if count == 1:
        return (light,)
    shares = tuple(part / count for part in light.intensity)
    places = [
        tuple(middle + light.radius * side for middle, side in zip(light.position, way, strict=True))
        for way in spread_on_sphere(count)
    ]
    size = light.radius * min(1.0, 2.0 / math.sqrt(count))
    return tuple(
        replace(light, position=place, intensity=shares, radius=size, shadow_points=1)  # type: ignore[arg-type]
        for place in places
    )


def split_sun(sun: Sun) -> tuple[Sun, ...]:
    """Points of the disc of a sun that together have its irradiance; the sun itself if it is one point."""
    count = sun.shadow_points
    if count == 1:
        return (sun,)
    red, green, blue = (part / count for part in sun.irradiance)
    across, up, towards = light_axes(sun.direction).tolist()
    suns = []
    for x, y in spread_on_disc(count):
        side, high = (math.tan(sun.angular_radius) * part for part in (x, y))
        aside = [c + side * a + high * u for a, u, c in zip(across, up, towards, strict=True)]
        length = math.hypot(*aside)
        direction = (aside[0] / length, aside[1] / length, aside[2] / length)
        suns.append(replace(sun, direction=direction, irradiance=(red, green, blue), shadow_points=1))
    return tuple(suns)


def spread_on_sphere(count: int) -> list[Vector]:
    """Unit vectors of even spread: equal slices of height, turned by the golden angle."""
    vectors = []
    for number in range(count):
        z = 1.0 - (2.0 * number + 1.0) / count
        flat, turn = math.sqrt(1.0 - z * z), number * GOLDEN_ANGLE
        vectors.append((flat * math.cos(turn), flat * math.sin(turn), z))
    return vectors


def spread_on_disc(count: int) -> list[tuple[float, float]]:
    """Places in the unit disc of even spread: rings of equal area, turned by the golden angle."""
    places = []
    for number in range(count):
        away, turn = math.sqrt((number + 0.5) / count), number * GOLDEN_ANGLE
        places.append((away * math.cos(turn), away * math.sin(turn)))
    return places
