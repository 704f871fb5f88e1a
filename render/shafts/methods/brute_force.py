"""Brute force: equal steps along the ray of every pixel, each asking whether it is lit."""

from dataclasses import dataclass, replace
from typing import Self

import torch

from render.shafts.march import march
from render.shafts.methods.base import Gathered, check_steps
from render.shafts.rays import uniform_edges
from render.shafts.stage import Stage

SAMPLES_AT_ONCE = 1 << 18
"""Rays times steps of a chunk: their numbers stay in the cache."""


@dataclass(frozen=True)
class BruteForce:
    """March along every pixel's ray.

    Args:
        steps: along each ray, at least 1.

    Raises:
        ParameterError: for fewer.
    """

    steps: int = 200

    def __post_init__(self) -> None:
        check_steps(self.steps)

    def gather(self, stage: Stage) -> Gathered:
        """In-scattered light of every pixel."""
        chunk = max(1, SAMPLES_AT_ONCE // self.steps)
        parts = []
        for first in range(0, len(stage.rays), chunk):
            rays = stage.rays[first : first + chunk]
            edges = uniform_edges(rays, self.steps)
            parts.append(march(stage.scene.air, stage.lighting, rays, edges).in_scattering)
        return Gathered(torch.cat(parts), (f"{self.steps} equal steps along every ray",))

    def refined(self) -> Self:
        """Twice as many steps."""
        return replace(self, steps=2 * self.steps)

    def at_full_density(self, steps: int) -> "BruteForce":
        """So many steps."""
        return BruteForce(steps)
