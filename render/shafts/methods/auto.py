"""The method that looks at the scene first, and models only what it requires."""

from dataclasses import dataclass, field, replace
from typing import Self

import torch

from render.shafts.march import ShadowLooks
from render.shafts.methods.adaptive import Adaptive
from render.shafts.methods.base import Gathered, Method
from render.shafts.methods.brute_force import BruteForce
from render.shafts.stage import Stage


@dataclass(frozen=True)
class Auto:
    """Adaptive marching without the parts that a scene makes superfluous.

    Args:
        adaptive: used where there are shadows.
        smooth_steps: steps along each ray where there are none.
    """

    adaptive: Adaptive = field(default_factory=Adaptive)
    smooth_steps: int = 12

    def gather(self, stage: Stage) -> Gathered:
        """In-scattered light of every pixel."""
        if stage.scene.air.empty:
            return Gathered(torch.zeros_like(stage.background), (), ("the march: nothing scatters",))
        if stage.lighting.sun is None and not stage.lighting.points:
            return Gathered(torch.zeros_like(stage.background), (), ("the march: nothing shines",))
        skipped = ["the sun: there is none"] if stage.lighting.sun is None else []
        if not stage.lighting.points:
            skipped.append("lamps: there are none")
        if len(stage.lighting.points) > 1:
            skipped.append(
                "froxels: the glow of a lamp is narrower than their cells, so marching it errs less at equal cost"
            )
        method: Method = self.adaptive
        if stage.caster.empty:
            skipped.append("shadows: nothing casts any, so the light is smooth and few steps suffice")
            sun_only = not stage.lighting.points and len(stage.scene.air.particles) == 1 and not stage.scene.air.banks
            steps = 1 if sun_only else self.smooth_steps
            if sun_only:
                skipped.append("the march: one medium under the sun has a closed form")
                method = BruteForce(steps)
            else:
                method = replace(
                    self.adaptive, steps=steps, looks=ShadowLooks(), lamp_steps=max(2, steps), lamp_looks=ShadowLooks()
                )
        gathered = method.gather(stage)
        return replace(gathered, skipped=(*gathered.skipped, *skipped))

    def refined(self) -> Self:
        """Its parts refined."""
        return replace(self, adaptive=self.adaptive.refined(), smooth_steps=2 * self.smooth_steps)

    def at_full_density(self, steps: int) -> Method:
        """As adaptive marching at full density."""
        return self.adaptive.at_full_density(steps)
