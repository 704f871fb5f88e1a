"""Min-max trees over epipolar slices: Chen, Baran, Durand & Jarosz 2011, "Real-time volumetric shadows using 1D min-max mipmaps"."""

from dataclasses import dataclass, field, replace
from typing import Self

import torch
from torch import Tensor

from render.shafts.epipolar_sampling import EpipolarSettings
from render.shafts.lights import Lighting
from render.shafts.methods.base import Gathered, check_steps
from render.shafts.methods.culling import gather_lit_parts, sun_map
from render.shafts.methods.engelhardt2010 import refine_lines
from render.shafts.methods.epipolar_light import describe, gather_along_lines
from render.shafts.methods.marching import march_rays
from render.shafts.rays import ViewRays, uniform_edges
from render.shafts.stage import Clock, Stage


@dataclass(frozen=True)
class Chen2011:
    """Lit stretches of rays along epipolar lines; lamps, and pixels beside the lines, are marched.

    Args:
        nodes: places along a ray at which its unshadowed light is computed, at least 1.
        steps: along rays that are marched.
        lines: how densely lines and samples lie; None for a slice of its own for every pixel.

    Raises:
        ParameterError: for fewer nodes or steps.
    """

    nodes: int = 32
    steps: int = 128
    lines: EpipolarSettings | None = field(default_factory=EpipolarSettings)

    def __post_init__(self) -> None:
        check_steps(self.nodes)
        check_steps(self.steps)

    def gather(self, stage: Stage) -> Gathered:
        """In-scattered light of every pixel."""
        clock, air, steps = Clock(), stage.scene.air, self.steps

        def marcher(lighting: Lighting, rays: ViewRays, line: Tensor | None) -> Tensor:
            seen = sun_map(stage, lighting)
            if seen is None or line is None or lighting.sun is None:
                return march_rays(air, lighting, rays, lambda part: uniform_edges(part, steps), steps)
            return gather_lit_parts(air, lighting.sun, seen, rays, line, self.nodes)

        if self.lines is None:
            own = torch.arange(len(stage.rays))
            light = torch.zeros_like(stage.background)
            for lighting in stage.lighting.separate():
                light += marcher(lighting, stage.rays, own)
            return Gathered(light, ("lit stretches of every pixel's ray",), seconds=clock.seconds)
        light = gather_along_lines(stage, stage.lighting, self.lines, marcher, clock)
        said = f"lit stretches along the samples of {describe(self.lines)}; lamps in {steps} equal steps"
        return Gathered(light, (said,), seconds=clock.seconds)

    def refined(self) -> Self:
        """Twice as many nodes and steps, and lines and samples twice as dense."""
        lines = None if self.lines is None else refine_lines(self.lines)
        return replace(self, nodes=2 * self.nodes, steps=2 * self.steps, lines=lines)

    def at_full_density(self, steps: int) -> "Chen2011":
        """A slice for every pixel."""
        return Chen2011(steps, steps, None)
