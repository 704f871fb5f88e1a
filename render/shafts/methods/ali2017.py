"""Marching few pixels and filling up the others: Ali et al. 2017, "Soft bilateral filtering volumetric shadows using cube shadow maps".

Their rays all have the same steps, so neighbours miss a shadow's border in the same direction, and no filter can tell. Interleaved
sampling (Keller & Heidrich 2001), which is not theirs, shifts the steps of neighbouring rays against each other in a small square
pattern: the errors of a square then cancel in the filter's mean. The registry has it as `interleaved`.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import torch
from torch import Tensor

from render.errors import ParameterError
from render.shafts.bilateral import ReducedFrame, fill_frame, filter_image
from render.shafts.methods.base import Gathered, check_steps
from render.shafts.methods.marching import march_rays
from render.shafts.rays import ViewRays, shifted_edges, uniform_edges
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
        pattern: edge of the squares of marched pixels whose steps are shifted against each other, a power of two; 1, as in the paper, for
            the same steps everywhere.

    Raises:
        ParameterError: for fewer steps or another pattern, or in `gather` for other numbers.
    """

    steps: int = 60
    factor: int = 2
    taps: int = 4
    depth_tolerance: float = 0.1
    march_unmatched: bool = True
    pattern: int = 1

    def __post_init__(self) -> None:
        check_steps(self.steps)
        if self.pattern < 1 or self.pattern & (self.pattern - 1):
            raise ParameterError(f"expected a pattern with an edge of 1, 2, 4, ... pixels, got {self.pattern}")

    def gather(self, stage: Stage) -> Gathered:
        """In-scattered light of every pixel."""
        clock, camera = Clock(), stage.scene.camera
        frame = ReducedFrame(camera.width, camera.height, self.factor)
        with clock.timed("marching"):
            marched = self._march_reduced(stage, frame)
        with clock.timed("filter"):
            if self.factor == 1:
                shape = (camera.height, camera.width)
                image = filter_image(marched.reshape(*shape, 3), stage.depth_buffer, self.taps, self.depth_tolerance)
                light = image.flatten(0, 1)
            else:
                filled = fill_frame(
                    frame,
                    marched,
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
        if self.pattern > 1:
            said += f", steps shifted in squares of {self.pattern}"
        return Gathered(light, (said,), seconds=clock.seconds)

    def _march_reduced(self, stage: Stage, frame: ReducedFrame) -> Tensor:
        """Light of the marched pixels `(reduced height, reduced width, channel)`, one shift of the steps after the other."""
        shape = (len(frame.rows), len(frame.columns))
        rays, edge, steps = stage.rays[frame.pixels()], self.pattern, self.steps
        if edge == 1:
            return self._march(stage, rays).reshape(*shape, 3)
        row, column = (torch.arange(size) % edge for size in shape)
        shifts = shift_pattern(edge)
        number = (row[:, None] * edge + column).flatten()
        light = torch.zeros_like(rays.origin)
        for place, shift in enumerate(shifts.flatten().tolist()):
            chosen = torch.nonzero(number == place)[:, 0]
            rule = partial(shifted_edges, steps=steps, shift=shift)
            light[chosen] = march_rays(stage.scene.air, stage.lighting, rays[chosen], rule, steps + 1)
        return light.reshape(*shape, 3)

    def _march(self, stage: Stage, rays: ViewRays) -> Tensor:
        steps = self.steps
        return march_rays(stage.scene.air, stage.lighting, rays, lambda part: uniform_edges(part, steps), steps)

    def refined(self) -> Self:
        """Twice as many steps, and half as large blocks, filled up linearly; once no block is left, nothing is shifted or filtered."""
        linear = self.pattern == 1 or self.factor == 1
        return replace(
            self,
            steps=2 * self.steps,
            factor=max(1, self.factor // 2),
            taps=min(self.taps, 2) if linear else self.taps,
            depth_tolerance=0.5 * self.depth_tolerance,
            pattern=1 if linear else self.pattern,
        )

    def at_full_density(self, steps: int) -> "Ali2017":
        """Every pixel marched, and nothing filtered."""
        return Ali2017(steps, factor=1, taps=1)


def shift_pattern(edge: int) -> Tensor:
    """Shifts of steps [1] in a square of pixels `(edge, edge)`: all of (k + 1/2) / edge^2, near ones far apart (Bayer 1973).

    The edge is a power of two.
    """
    order = torch.zeros(1, 1)
    while len(order) < edge:
        order = torch.cat([torch.cat([4 * order, 4 * order + 2], 1), torch.cat([4 * order + 3, 4 * order + 1], 1)])
    return (order + 0.5) / order.numel()
