"""Brute force: equal steps along the ray of every pixel, each asking whether it is lit."""

from dataclasses import dataclass, replace
from typing import Self

from render.shafts.methods.base import Gathered, check_steps
from render.shafts.methods.marching import march_rays
from render.shafts.rays import uniform_edges
from render.shafts.stage import Stage


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
        steps = self.steps
        light = march_rays(stage.scene.air, stage.lighting, stage.rays, lambda rays: uniform_edges(rays, steps), steps)
        return Gathered(light, (f"{steps} equal steps along every ray, lit by {stage.lighting.names}",))

    def refined(self) -> Self:
        """Twice as many steps."""
        return replace(self, steps=2 * self.steps)

    def at_full_density(self, steps: int) -> "BruteForce":
        """So many steps."""
        return BruteForce(steps)
