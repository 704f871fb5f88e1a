"""Marching few pixels and filling up the others: Ali et al. 2017, "Soft bilateral filtering volumetric shadows using cube shadow maps"."""

from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor

from render.shafts.bilateral import ReducedFrame, fill_frame, filter_image
from render.shafts.methods.base import Gathered, check_steps
from render.shafts.methods.marching import march_rays
from render.shafts.rays import ViewRays, uniform_edges
from render.shafts.stage import Clock, Stage


@dataclass(frozen=True)
class Ali2017:
    """Equal steps along the rays of a reduced frame; two passes along rows and columns that keep edges of depth fill the whole one.

    Args:
        steps: along each ray that is marched, at least 1.
        factor: edge of the blocks of which one pixel is marched [pixel].
        taps: marched pixels in each pass, one of `render.shafts.bilateral.TAP_COUNTS`.
        depth_tolerance: ratio of depths minus 1 within which pixels belong together.
        march_unmatched: march pixels that no marched one of like depth reaches, instead of guessing them.

    Raises:
        ParameterError: for fewer steps, or in `gather` for other numbers.
    """

    steps: int = 60
    factor: int = 2
    taps: int = 4
    depth_tolerance: float = 0.1
    march_unmatched: bool = True

    def __post_init__(self) -> None:
        check_steps(self.steps)

    def gather(self, stage: Stage) -> Gathered:
        """In-scattered light of every pixel."""
        clock, camera = Clock(), stage.scene.camera
        frame = ReducedFrame(camera.width, camera.height, self.factor)
        with clock.timed("marching"):
            marched = self._march(stage, stage.rays[frame.pixels()])
        with clock.timed("filter"):
            if self.factor == 1:
                shape = (camera.height, camera.width)
                image = filter_image(marched.unflatten(0, shape), stage.depth_buffer, self.taps, self.depth_tolerance)
                light = image.flatten(0, 1)
            else:
                filled = fill_frame(
                    frame,
                    marched.reshape(len(frame.rows), len(frame.columns), 3),
                    stage.depth_buffer,
                    self.taps,
                    self.depth_tolerance,
                )
                light, unmatched = filled.image.flatten(0, 1), filled.unmatched.flatten()
        if self.factor > 1 and self.march_unmatched:
            with clock.timed("marching"):
                lost = torch.nonzero(unmatched)[:, 0]
                light[lost] = self._march(stage, stage.rays[lost])
        said = (
            f"{self.steps} equal steps along the ray of one pixel in {self.factor**2}, filled up with {self.taps} taps, "
            f"lit by {stage.lighting.names}"
        )
        return Gathered(light, (said,), seconds=clock.seconds)

    def _march(self, stage: Stage, rays: ViewRays) -> Tensor:
        steps = self.steps
        return march_rays(stage.scene.air, stage.lighting, rays, lambda part: uniform_edges(part, steps), steps)

    def refined(self) -> Self:
        """Twice as many steps, and half as large blocks, filled up linearly."""
        return replace(
            self,
            steps=2 * self.steps,
            factor=max(1, self.factor // 2),
            taps=min(self.taps, 2),
            depth_tolerance=0.5 * self.depth_tolerance,
        )

    def at_full_density(self, steps: int) -> "Ali2017":
        """Every pixel marched, and nothing filtered."""
        return Ali2017(steps, factor=1, taps=1)
