"""Marching many rays in chunks that fit the cache."""

from collections.abc import Callable

import torch
from torch import Tensor

from render.shafts.air import Air
from render.shafts.lights import Lighting
from render.shafts.march import ONE_LOOK, ShadowLooks, gather_light
from render.shafts.rays import ViewRays

SAMPLES_AT_ONCE = 1 << 18
"""Rays times steps of a chunk."""

EdgeRule = Callable[[ViewRays], Tensor]
"""Borders of the steps `(ray, step + 1)` [m] of rays."""


def march_rays(
    air: Air,
    lighting: Lighting,
    rays: ViewRays,
    rule: EdgeRule,
    steps: int,
    spent: float = 0.0,
    looks: ShadowLooks = ONE_LOOK,
) -> Tensor:
    """In-scattered light of rays.

    Args:
        air: what scatters.
        lighting: what lights it.
        rays: any number.
        rule: where the steps lie.
        steps: how many they are.
        spent: transmittance [1] at which a ray may be left; 0 for never.
        looks: how shadows are looked up.

    Returns:
        Light `(ray, channel)`.
    """
    chunk = max(1, SAMPLES_AT_ONCE // (steps * looks.count))
    parts = []
    for first in range(0, len(rays), chunk):
        part = rays[first : first + chunk]
        parts.append(gather_light(air, lighting, part, rule(part), spent, looks))
    return torch.cat(parts) if parts else rays.origin.new_zeros(0, 3)
