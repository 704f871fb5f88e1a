"""Adaptive marching after Tan et al. 2020, "Adaptive volumetric light and atmospheric scattering": every part can be switched off.

What is smooth is computed rarely and what is sharp often. Along a ray, the light that the air would scatter without shadows needs few
steps (shorter ones near a lamp), each of which looks up the shadows at several places. Across the image few rays are marched: for
the sun samples on epipolar lines, for lamps one pixel of a block, for the glow around a lamp is no feature of lines. Pixels are marched
by themselves where the depth jumps, and for each light where that of neighbouring marched pixels differs.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Self

import torch
from torch import Tensor

from render.errors import ParameterError
from render.shafts.air import Air
from render.shafts.bilateral import ReducedFrame, fill_frame
from render.shafts.epipolar_sampling import EpipolarSettings
from render.shafts.fog_bank import insert_bank_edges
from render.shafts.lamp_steps import edges_towards_lamp
from render.shafts.lights import Lighting
from render.shafts.march import ShadowLooks
from render.shafts.methods.base import Gathered, Method, check_steps
from render.shafts.methods.engelhardt2010 import refine_lines
from render.shafts.methods.epipolar_light import LineMarcher, describe, gather_along_lines
from render.shafts.methods.marching import EdgeRule, march_rays
from render.shafts.rays import ViewRays
from render.shafts.stage import Clock, Stage
from render.shafts.step_schedule import StepSchedule

SMALLEST_LINES, SMALLEST_SAMPLES, SMALLEST_BLOCKS = 200, 40, 10
"""Epipolar lines along the height of an image, marched samples along a line of that length, and blocks, below which no image goes."""


@dataclass(frozen=True)
class Adaptive:
    """Few steps with several looks for shadows, along few rays.

    Args:
        steps: along a ray.
        looks: how shadows are looked up in each step.
        near_share: share of the steps that the near level has, 0..1; 0 for equal steps.
        near_part: share of the longest ray that the near level covers, 0..1.
        factor: edge of the blocks of which one pixel is marched [pixel]; 1 for every pixel.
        lines: epipolar lines for the sun; None for blocks, as where there are banks of fog.
        depth_tolerance: ratio of depths minus 1 within which pixels belong together.
        contrast: difference of light between neighbouring marched pixels, as a share of the mean light of the image, above which the
            pixels between them are marched; infinite for never.
        spent: transmittance [1] at which a ray is left; 0 for never.
        lamp_steps: of half a turn at a lamp, those of a ray subtending equal angles; None for steps as for the sun.
        lamp_looks: how shadows of lamps are looked up in each step.
        bank_steps: further steps within each bank of fog, over those of the light; 0 for none.

    Raises:
        ParameterError: for numbers outside these bounds.
    """

    steps: int = 16
    looks: ShadowLooks = field(default_factory=lambda: ShadowLooks(7, 4))
    near_share: float = 0.0
    near_part: float = 0.3
    factor: int = 4
    lines: EpipolarSettings | None = field(default_factory=lambda: EpipolarSettings(2.5, 1.0, 16, 0.1))
    depth_tolerance: float = 0.1
    contrast: float = 0.4
    spent: float = 1e-3
    lamp_steps: int | None = 10
    lamp_looks: ShadowLooks = field(default_factory=lambda: ShadowLooks(4, 4))
    bank_steps: float = 3.0

    def __post_init__(self) -> None:
        for count in (self.steps, self.factor):
            check_steps(count)
        if self.lamp_steps is not None and self.lamp_steps < 2:
            raise ParameterError(f"expected at least two steps of half a turn at a lamp, got {self.lamp_steps}")
        if not (0.0 <= self.near_share < 1.0 and 0.0 < self.near_part <= 1.0 and 0.0 <= self.spent < 1.0):
            raise ParameterError(f"expected shares within 0..1, got {self}")
        if not 0.0 <= self.bank_steps <= 1e3:
            raise ParameterError(f"expected from 0 to 1000 steps within a bank for each step, got {self.bank_steps}")
        if not (self.contrast > 0.0 and self.depth_tolerance > 0.0):
            raise ParameterError(f"expected a positive contrast and depth tolerance, got {self}")

    def gather(self, stage: Stage) -> Gathered:
        """In-scattered light of every pixel."""
        clock, air = Clock(), stage.scene.air
        schedule = self.schedule(float(stage.rays.distance.max()))

        def marcher(lighting: Lighting, rays: ViewRays, _: Tensor | None) -> Tensor:
            light = torch.zeros_like(rays.origin)
            for alone in lighting.separate():
                rule, steps = self._edge_rule(air, alone, schedule)
                looks = self.lamp_looks if alone.sun is None else self.looks
                light += march_rays(air, alone, rays, rule, steps, self.spent, looks)
            return light

        said = [self._describe_steps(stage.lighting)]
        light, blocks = torch.zeros_like(stage.background), stage.lighting
        # Banks of fog vary along the lines as well as across them.
        if self.lines is not None and blocks.sun is not None and not air.banks:
            lines = _limit_lines(self.lines, stage.scene.camera.height)
            light = gather_along_lines(stage, replace(blocks, points=()), lines, marcher, clock)
            blocks = Lighting(points=blocks.points)
            said.append(f"the sun: {describe(lines)}")
        if blocks.sun is not None or blocks.points:
            more, marched = self._gather_blocks(stage, blocks, marcher, clock)
            light = light + more
            said.append(f"{blocks.names}: {marched:.1%} of the rays marched")
        return Gathered(light, tuple(said), seconds=clock.seconds)

    def _describe_steps(self, lighting: Lighting) -> str:
        """Steps and looks of the lights that there are, in words."""
        parts = []
        if lighting.sun is not None or self.lamp_steps is None:
            parts.append(f"{self.steps} steps of {self.looks.count} looks for shadows")
        if lighting.points and self.lamp_steps is not None:
            parts.append(f"{self.lamp_steps} steps of {self.lamp_looks.count} looks for half a turn at a lamp")
        return ", ".join(parts)

    def schedule(self, longest: float) -> StepSchedule:
        """Steps along rays up to a length [m]."""
        if self.steps < 2 or self.near_share == 0.0 or self.near_part == 1.0:
            return StepSchedule.uniform(self.steps)
        return StepSchedule.from_ratio(self.steps, self.near_share, 1.0 - self.near_share, self.near_part * longest)

    def _edge_rule(self, air: Air, alone: Lighting, schedule: StepSchedule) -> tuple[EdgeRule, int]:
        """Where the steps lie for one light, and how many: as in clear air, and more of them within banks of fog."""
        rule, steps = self._clear_rule(alone, schedule)
        in_bank = round(self.bank_steps * steps)
        return lambda rays: insert_bank_edges(rays, rule(rays), air.banks, in_bank), steps + len(air.banks) * (
            in_bank + 1
        )

    def _clear_rule(self, alone: Lighting, schedule: StepSchedule) -> tuple[EdgeRule, int]:
        """By the schedule for the sun, and in equal angles at a lamp."""
        angular = self.lamp_steps
        if alone.sun is not None or angular is None:
            return lambda rays: schedule.tile(torch.zeros_like(rays.distance), rays.distance).edges, schedule.steps
        lamp = alone.points[0].light
        return lambda rays: edges_towards_lamp(rays, lamp.position, lamp.radius, angular), angular

    def _gather_blocks(
        self, stage: Stage, lights: Lighting, marcher: LineMarcher, clock: Clock
    ) -> tuple[Tensor, float]:
        """Light of all pixels, and the share of them that was marched."""
        camera = stage.scene.camera
        factor = min(self.factor, max(1, camera.height // SMALLEST_BLOCKS))
        if factor == 1:
            with clock.timed("marching"):
                return marcher(lights, stage.rays, None), 1.0
        frame = ReducedFrame(camera.width, camera.height, factor)
        separate = lights.separate()
        with clock.timed("marching"):
            some = stage.rays[frame.pixels()]
            shape = (len(frame.rows), len(frame.columns), 3)
            marched = [marcher(alone, some, None).reshape(shape) for alone in separate]
        mean = float(sum(marched[1:], marched[0]).mean())
        total, count = torch.zeros_like(stage.background), 0
        for alone, one in zip(separate, marched, strict=True):
            with clock.timed("filling"):
                filled = fill_frame(frame, one, stage.depth_buffer, 2, self.depth_tolerance)
                light = filled.image.flatten(0, 1)
                refined = filled.unmatched | self._contrasting(one, frame, mean)
                refined[frame.rows[:, None], frame.columns] = False
                own = torch.nonzero(refined.flatten())[:, 0]
            with clock.timed("refinement"):
                light[own] = marcher(alone, stage.rays[own], None)
                total += light
            count += len(own)
        return total, (len(some) + count / len(separate)) / len(total)

    def _contrasting(self, marched: Tensor, frame: ReducedFrame, mean: float) -> Tensor:
        """True for pixels `(height, width)` between marched ones whose light differs too much for a mean light of the image."""
        if math.isinf(self.contrast):
            return torch.zeros(frame.height, frame.width, dtype=torch.bool)
        grey = marched.mean(-1)[None, None]
        spread = torch.nn.functional.max_pool2d(grey, 3, 1, 1) + torch.nn.functional.max_pool2d(-grey, 3, 1, 1)
        high = (spread > self.contrast * mean)[0, 0]
        rows, columns = (torch.arange(size) // frame.factor for size in (frame.height, frame.width))
        return high[rows.clamp(max=high.shape[0] - 1)][:, columns.clamp(max=high.shape[1] - 1)]

    def refined(self) -> Self:
        """Half as large blocks and steps, or lines twice as dense."""
        return replace(
            self,
            steps=2 * self.steps,
            looks=ShadowLooks(self.looks.count, self.looks.halvings + 1),
            lamp_steps=None if self.lamp_steps is None else 2 * self.lamp_steps,
            lamp_looks=ShadowLooks(self.lamp_looks.count, self.lamp_looks.halvings + 1),
            factor=max(1, self.factor - 1),
            lines=None if self.lines is None else refine_lines(self.lines),
            depth_tolerance=0.5 * self.depth_tolerance,
            contrast=0.5 * self.contrast,
            spent=0.5 * self.spent,
        )

    def at_full_density(self, steps: int) -> Method:
        """Equal steps along every ray, one look in each, to its end."""
        return Adaptive(
            steps,
            ShadowLooks(),
            0.0,
            1.0,
            1,
            None,
            contrast=math.inf,
            spent=0.0,
            lamp_steps=None,
            lamp_looks=ShadowLooks(),
            bank_steps=0.0,
        )


def _limit_lines(lines: EpipolarSettings, height: int) -> EpipolarSettings:
    """Lines and samples no farther apart than light in a small image of a height [pixel] allows."""
    gap, stride = height / SMALLEST_LINES, max(1, height // SMALLEST_SAMPLES)
    return replace(lines, line_gap=min(lines.line_gap, gap), stride=min(lines.stride, stride))
