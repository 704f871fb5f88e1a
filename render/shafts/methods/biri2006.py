"""Light between the borders of shadows: Biri, Arques & Michelin 2006, "Real time rendering of atmospheric scattering and volumetric
shadows".

Theirs: the shadow volumes of a scene are rasterised as polygons, and each of them adds or takes the analytic integral of the light
between the eye and the place where a pixel's ray crosses it, so that what remains is the light between the borders of shadows.

Ours: the places come from looks along the ray, the borders between a lit and a dark look being halved in, instead of from polygons;
a shadow thinner than the gap between looks may be missed. Sunlight between the borders is read from its integral without shadows,
tabulated along the ray, as the air may have several layers. Lamps are marched, with the same looks.
"""

from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor

from render.shafts.air import Air
from render.shafts.lamp_steps import edges_towards_lamp
from render.shafts.lights import Lighting, SunInScene, Visibility
from render.shafts.lit_intervals import LitIntervals, join_touching
from render.shafts.march import ShadowLooks, accumulate_sunlight
from render.shafts.methods.base import Gathered, check_steps
from render.shafts.methods.marching import march_rays
from render.shafts.rays import ViewRays, uniform_edges
from render.shafts.stage import Stage

LOOKS_AT_ONCE = 1 << 19
"""Places looked at in one go."""

LOOKS_PER_STEP = 4
"""Parts of a step of a lamp that are looked at."""


@dataclass(frozen=True)
class Biri2006:
    """Lit stretches of every pixel's ray.

    Args:
        looks: stretches of a ray at whose ends shadows are looked up, at least 1.
        halvings: of a stretch with a border, at least 1.
        nodes: places along a ray at which its unshadowed light is computed, at least 1.

    Raises:
        ParameterError: for fewer.
    """

    looks: int = 64
    halvings: int = 12
    nodes: int = 16

    def __post_init__(self) -> None:
        for count in (self.looks, self.halvings, self.nodes):
            check_steps(count)

    def gather(self, stage: Stage) -> Gathered:
        """In-scattered light of every pixel."""
        air, light = stage.scene.air, torch.zeros_like(stage.background)
        for alone in stage.lighting.separate():
            if alone.sun is not None:
                light += self._gather_sun(air, alone.sun, stage.rays)
            else:
                light += self._gather_lamp(air, alone, stage.rays)
        said = (
            f"light between borders of shadows, from {self.looks} looks along every ray, lit by {stage.lighting.names}"
        )
        return Gathered(light, (said,))

    def _gather_sun(self, air: Air, sun: SunInScene, rays: ViewRays) -> Tensor:
        share = torch.arange(self.nodes + 1, dtype=torch.float64) / self.nodes
        parts, chunk = [], max(1, LOOKS_AT_ONCE // max(self.looks, 3 * self.nodes))
        for first in range(0, len(rays), chunk):
            some = rays[first : first + chunk]
            lit = find_lit_stretches(sun.visibility, some, self.looks, self.halvings)
            parts.append(lit.integrate(share, accumulate_sunlight(air, sun, some, uniform_edges(some, self.nodes))))
        return torch.cat(parts)

    def _gather_lamp(self, air: Air, alone: Lighting, rays: ViewRays) -> Tensor:
        lamp, steps = alone.points[0].light, max(2, self.looks // LOOKS_PER_STEP)
        looks = ShadowLooks(LOOKS_PER_STEP, self.halvings)
        return march_rays(
            air,
            alone,
            rays,
            lambda some: edges_towards_lamp(some, lamp.position, lamp.radius, steps),
            steps,
            looks=looks,
        )

    def refined(self) -> Self:
        """Twice as many looks and nodes."""
        return replace(self, looks=2 * self.looks, nodes=2 * self.nodes)

    def at_full_density(self, steps: int) -> "Biri2006":
        """As many looks and nodes."""
        return Biri2006(steps, self.halvings, steps)


def find_lit_stretches(visibility: Visibility, rays: ViewRays, looks: int, halvings: int) -> LitIntervals:
    """Lit stretches of rays.

    Args:
        visibility: which points see the light.
        rays: at least one.
        looks: stretches of each ray at whose ends is looked.
        halvings: of those whose ends differ, as if they held one border.

    Returns:
        The stretches, as fractions of the rays, float64.
    """
    share = torch.arange(looks + 1, dtype=rays.distance.dtype) / looks
    lit = visibility.look_up_lit(rays.points_at(rays.distance[:, None] * share))
    fraction = share.double()
    whole = torch.nonzero(lit[:, 1:] & lit[:, :-1])
    mixed, place = torch.nonzero(lit[:, 1:] != lit[:, :-1]).unbind(1)
    starts_lit = lit[mixed, place]
    low, high = fraction[place], fraction[place + 1]
    some = rays[mixed]
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        points = some.points_at((middle.to(some.distance) * some.distance)[:, None])
        same = visibility.look_up_lit(points)[:, 0] == starts_lit
        low, high = torch.where(same, middle, low), torch.where(same, high, middle)
    border = 0.5 * (low + high)
    start = torch.cat([fraction[whole[:, 1]], torch.where(starts_lit, fraction[place], border)])
    end = torch.cat([fraction[whole[:, 1] + 1], torch.where(starts_lit, border, fraction[place + 1])])
    return join_touching(torch.cat([whole[:, 0], mixed]), start, end, len(rays))
