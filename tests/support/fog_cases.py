"""Random fog, eyes, views and suns, with every singular direction among them, for the media and for the plain quadrature alike."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from render.media import ExponentialDecay, LayeredMedium, LinearDecay, Uniform
from tests.support.fog_quadrature import PlainFog, PlainRays

Array = np.ndarray


@dataclass(frozen=True)
class FogCases:
    """The same configurations twice: numbers of the medium and rays for the quadrature, tensors for the package.

    The quadrature counts heights from the beginnings of the rays, the package from sea level.
    """

    medium: LayeredMedium
    fog: PlainFog
    rays: PlainRays
    height: Tensor

    @property
    def slope(self) -> Tensor:
        return torch.from_numpy(self.rays.slope)

    @property
    def sun_slope(self) -> Tensor:
        return torch.from_numpy(self.rays.sun_slope)

    @property
    def distance(self) -> Tensor:
        return torch.from_numpy(self.rays.distance)


def draw_cases(name: str, count: int, seed: int) -> FogCases:
    """Configurations of one medium: vertical optical depths 1e-8 to 1e4, thickness 1 m to 10 km, eyes below, within and above."""
    random = np.random.default_rng(seed)
    base = random.choice([0.0, -30.0, 250.0], count)
    thickness = 10.0 ** random.uniform(0.0, 4.0, count)
    vertical = 10.0 ** random.uniform(-8.0, 4.0, count)
    rays = _draw_rays(random, base, thickness)
    medium, fog = _MAKERS[name](base, thickness, vertical / thickness, rays.height)
    from_start = replace(rays, height=np.zeros_like(rays.height))
    return FogCases(medium, fog, from_start, torch.from_numpy(rays.height))


def _draw_rays(random: np.random.Generator, base: Array, thickness: Array) -> PlainRays:
    count = len(base)
    height = base + thickness * random.choice([-0.5, 0.0, 0.001, 0.3, 0.5, 0.999, 1.0, 1.7], count)
    slope, sun = random.uniform(-1.0, 1.0, count), random.uniform(-1.0, 1.0, count)
    tiny = 10.0 ** random.uniform(-16.0, -1.0, count) * random.choice([-1.0, 1.0], count)
    kind = random.integers(0, 8, count)
    slope = np.select([kind == 0, kind == 1, kind == 2], [0.0, tiny, np.sign(slope)], slope)
    kind = random.integers(0, 8, count)
    sun = np.select(
        [kind == 0, kind == 1, kind == 2, kind == 3],
        [slope, np.clip(slope + tiny, -1.0, 1.0), 10.0 ** random.uniform(-4.0, 0.0, count), 1.0],
        sun,
    )
    # Closer to level the quadrature cannot resolve in which millionth of a ray the light arrives; that limit is a test of its own.
    sun = np.where(np.abs(sun) < 1e-4, np.copysign(1e-4, sun), sun)
    sun = np.where(random.integers(0, 10, count) == 0, 0.0, sun)
    distance = thickness * 10.0 ** random.uniform(-3.0, 2.0, count)
    kind = random.integers(0, 6, count)
    distance = np.select([kind == 0, kind == 1, kind == 2], [0.0, np.inf, thickness * 1e-9], distance)
    return PlainRays(height, slope, sun, distance)


def _uniform(base: Array, thickness: Array, extinction: Array, eye: Array) -> tuple[LayeredMedium, PlainFog]:
    top = base + thickness
    medium = Uniform(torch.from_numpy(extinction), torch.from_numpy(top), torch.from_numpy(base))
    return medium, PlainFog(lambda h, i: extinction[i], base - eye, top - eye, np.full_like(base, np.inf))


def _linear(base: Array, thickness: Array, extinction: Array, eye: Array) -> tuple[LayeredMedium, PlainFog]:
    top = base + thickness
    medium = LinearDecay(torch.from_numpy(2.0 * extinction), torch.from_numpy(top), torch.from_numpy(base))
    above = top - eye
    gradient = 2.0 * extinction / (top - base)
    return medium, PlainFog(lambda h, i: gradient[i] * (above[i] - h), base - eye, above, np.full_like(base, np.inf))


def _exponential(base: Array, thickness: Array, extinction: Array, eye: Array) -> tuple[LayeredMedium, PlainFog]:
    scale, reference = 0.3 * thickness, base + 0.1 * thickness
    # Every fifth layer goes on downwards for ever.
    base = np.where(np.arange(len(base)) % 5 == 0, -np.inf, base)
    fields = (torch.from_numpy(field) for field in (extinction, scale, base, reference))
    return ExponentialDecay(*fields), PlainFog(
        lambda h, i: extinction[i] * np.exp(-(h + (eye - reference)[i]) / scale[i]),
        base - eye,
        np.full_like(base, np.inf),
        scale,
    )


_MAKERS: dict[str, Callable[[Array, Array, Array, Array], tuple[LayeredMedium, PlainFog]]] = {
    "uniform": _uniform,
    "linear": _linear,
    "exponential": _exponential,
}
