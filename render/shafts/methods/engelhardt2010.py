"""Epipolar sampling: Engelhardt & Dachsbacher 2010, "Epipolar sampling for shadows and crepuscular rays in participating media"."""

from dataclasses import dataclass, field, replace
from typing import Self

from torch import Tensor

from render.shafts.epipolar_sampling import EpipolarSettings
from render.shafts.lights import Lighting
from render.shafts.methods.base import Gathered, Method, check_steps
from render.shafts.methods.brute_force import BruteForce
from render.shafts.methods.epipolar_light import describe, gather_along_lines
from render.shafts.methods.marching import march_rays
from render.shafts.rays import ViewRays, uniform_edges
from render.shafts.stage import Clock, Stage


@dataclass(frozen=True)
class Engelhardt2010:
    """Equal steps along few rays, which lie on lines through the images of the lights; the others are interpolated.

    Args:
        steps: along each ray that is marched, at least 1.
        lines: how densely lines and samples lie.

    Raises:
        ParameterError: for fewer steps.
    """

    steps: int = 128
    lines: EpipolarSettings = field(default_factory=EpipolarSettings)

    def __post_init__(self) -> None:
        check_steps(self.steps)

    def gather(self, stage: Stage) -> Gathered:
        """In-scattered light of every pixel."""
        clock, air, steps = Clock(), stage.scene.air, self.steps

        def marcher(lighting: Lighting, rays: ViewRays, _: Tensor | None) -> Tensor:
            return march_rays(air, lighting, rays, lambda part: uniform_edges(part, steps), steps)

        light = gather_along_lines(stage, stage.lighting, self.lines, marcher, clock)
        said = f"{steps} equal steps along the samples of {describe(self.lines)}, lit by {stage.lighting.names}"
        return Gathered(light, (said,), seconds=clock.seconds)

    def refined(self) -> Self:
        """Twice as many steps, and lines and samples twice as dense."""
        return replace(self, steps=2 * self.steps, lines=refine_lines(self.lines))

    def at_full_density(self, steps: int) -> Method:
        """Every pixel is refined, which leaves equal steps along every ray."""
        return BruteForce(steps)


def refine_lines(lines: EpipolarSettings) -> EpipolarSettings:
    """Lines and samples twice as dense, and depths told apart twice as finely."""
    return replace(
        lines,
        line_gap=0.5 * lines.line_gap,
        sample_gap=0.7 * lines.sample_gap,
        stride=max(1, lines.stride // 2),
        depth_tolerance=0.5 * lines.depth_tolerance,
    )
