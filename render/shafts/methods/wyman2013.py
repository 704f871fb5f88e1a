"""Marching with shadows from voxels around the line from eye to light: Wyman & Dai 2013, "Imperfect voxelized shadow volumes"."""

from dataclasses import dataclass, field, replace
from typing import Self

import torch

from render.camera import PinholeCamera
from render.shafts.lights import Lighting
from render.shafts.methods.base import Gathered, Method, check_steps
from render.shafts.methods.brute_force import BruteForce
from render.shafts.methods.marching import march_rays
from render.shafts.rays import uniform_edges
from render.shafts.stage import Clock, Stage
from render.shafts.voxel_shadows import VoxelCounts, VoxelShadows, build_voxel_shadows


@dataclass(frozen=True)
class Wyman2013:
    """Equal steps along the ray of every pixel, whose shadows come from a grid of voxels for each light.

    Parallel rays have no eye for the grid, and are marched with the maps.

    Args:
        steps: along each ray, at least 1.
        voxels: of each grid.

    Raises:
        ParameterError: for fewer steps.
    """

    steps: int = 128
    voxels: VoxelCounts = field(default_factory=VoxelCounts)

    def __post_init__(self) -> None:
        check_steps(self.steps)

    def gather(self, stage: Stage) -> Gathered:
        """In-scattered light of every pixel."""
        clock, steps = Clock(), self.steps
        light = torch.zeros_like(stage.background)
        for alone in stage.lighting.separate():
            with clock.timed("voxels"):
                seen = self._voxelise(stage, alone)
            with clock.timed("marching"):
                light += march_rays(stage.scene.air, seen, stage.rays, lambda rays: uniform_edges(rays, steps), steps)
        counts = self.voxels
        said = (
            f"{steps} equal steps along every ray, shadows in {counts.planes} x {counts.view_rays} x {counts.light_rays} voxels, "
            f"lit by {stage.lighting.names}"
        )
        return Gathered(light, (said,), seconds=clock.seconds)

    def _voxelise(self, stage: Stage, alone: Lighting) -> Lighting:
        """The one light with its shadows from voxels, unless it casts none or there is no eye."""
        if stage.caster.empty or not isinstance(stage.scene.camera, PinholeCamera):
            return alone
        if alone.sun is not None:
            return Lighting(replace(alone.sun, visibility=self._build(stage, alone.sun.light.direction, True)))
        point = alone.points[0]
        return Lighting(points=(replace(point, visibility=self._build(stage, point.light.position, False)),))

    def _build(self, stage: Stage, towards: tuple[float, float, float], at_infinity: bool) -> VoxelShadows:
        return build_voxel_shadows(stage.caster, towards, stage.rays, self.voxels, at_infinity)

    def refined(self) -> Self:
        """Twice as many steps, and voxels half as large along each axis."""
        counts = self.voxels
        finer = VoxelCounts(2 * counts.planes, 2 * counts.view_rays, 2 * counts.light_rays)
        return replace(self, steps=2 * self.steps, voxels=finer)

    def at_full_density(self, steps: int) -> Method:
        """Without voxels, which leaves equal steps along every ray."""
        return BruteForce(steps)
