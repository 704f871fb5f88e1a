"""Froxels: the light of all lamps in one volume that is aligned with the view, summed front to back in one pass.

Tan et al. 2020, "Adaptive volumetric light and atmospheric scattering", section on many lights, after Wronski 2014, "Volumetric fog". Each
cell is marched as a ray of one step from its front to its back: the light that it sends, over the share of that light which its own front
lets through, is its source. So lamps, sun, shadows and banks of fog enter a cell as they enter a step of any other method.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import torch
from torch import Tensor

from render.errors import ParameterError
from render.shafts.froxel_volume import FroxelVolume, accumulate_froxels, look_up_froxels, mean_transmittance
from render.shafts.march import ShadowLooks, march
from render.shafts.methods.base import Gathered, check_steps
from render.shafts.rays import ViewRays
from render.shafts.stage import Clock, Stage

CELLS_AT_ONCE = 1 << 16
"""Cells marched at once: bounds the memory."""


@dataclass(frozen=True)
class Froxels:
    """A volume of cells in the frame's perspective.

    Args:
        cells: along each ray, from the eye to the farthest surface, at least 1.
        factor: edge of the blocks of pixels that share a column of cells [pixel].
        growth: how much longer the last cell is than the first, as far as lamps do not shorten them; 1 for equal ones.
        gathering: half the stretch within which cells gather around a lamp, over its distance; 0 for no gathering.
        looks: how shadows are looked up in each cell.

    Raises:
        ParameterError: for fewer cells, blocks of no pixel, a growth below 1, or a negative gathering.
    """

    cells: int = 64
    factor: int = 3
    growth: float = 4.0
    gathering: float = 0.05
    looks: ShadowLooks = field(default_factory=lambda: ShadowLooks(2))

    def __post_init__(self) -> None:
        check_steps(self.cells)
        if self.factor < 1 or not 1.0 <= self.growth < math.inf:
            raise ParameterError(f"expected blocks of at least one pixel and a finite growth of at least 1, got {self}")
        if not 0.0 <= self.gathering < math.inf:
            raise ParameterError(f"expected a finite gathering of at least 0, got {self}")

    def gather(self, stage: Stage) -> Gathered:
        """In-scattered light of every pixel."""
        clock, camera = Clock(), stage.scene.camera
        width, height = (-(-size // self.factor) for size in (camera.width, camera.height))
        with clock.timed("cells"):
            volume = self._fill(stage, width, height)
        with clock.timed("look-up"):
            number = torch.arange(camera.width * camera.height)
            columns = (number % camera.width + 0.5) / self.factor
            rows = (number // camera.width + 0.5) / self.factor
            light, _ = look_up_froxels(volume, columns, rows, stage.rays.distance)
        said = f"{width} x {height} x {self.cells} froxels, lit by {stage.lighting.names}"
        return Gathered(light, (said,), seconds=clock.seconds)

    def edges(self, farthest: float, lamps: Sequence[float] = ()) -> Tensor:
        """Distances from the eye at which cells begin and end.

        Args:
            farthest: the last one [m].
            lamps: distances of the lamps [m], around which half of the cells gather, if there are any.

        Returns:
            Distances `(cell + 1,)` [m], rising; without lamps their differences grow by a constant factor.
        """
        share = torch.linspace(0.0, 1.0, 64 * self.cells + 1, dtype=torch.float64)
        if self.growth > 1.0:
            share = torch.expm1(math.log(self.growth) * share) / (self.growth - 1.0)
        # Number of cells before a distance, as a share: evenly by growth, and by the angle that a distance subtends beside each lamp.
        before = torch.linspace(0.0, 1.0, 64 * self.cells + 1, dtype=torch.float64)
        if lamps and self.gathering > 0.0:
            angles = [torch.atan((farthest * share - lamp) / (self.gathering * lamp)) for lamp in lamps]
            near = sum((angle - angle[0]) / (angle[-1] - angle[0]) for angle in angles) / len(lamps)
            before = 0.5 * (before + near)
        wanted = torch.linspace(0.0, 1.0, self.cells + 1, dtype=torch.float64)
        after = torch.searchsorted(before, wanted).clamp(1, len(before) - 1)
        part = (wanted - before[after - 1]) / (before[after] - before[after - 1])
        return (farthest * torch.lerp(share[after - 1], share[after], part)).float()

    def _fill(self, stage: Stage, width: int, height: int) -> FroxelVolume:
        """March all cells, one ray of one step each, and sum them."""
        x, y = (torch.arange(count) + 0.5 for count in (width, height))
        rows, columns = torch.meshgrid(y, x, indexing="ij")
        centres = self.factor * torch.stack([columns, rows], dim=-1).reshape(-1, 2)
        origin, direction = stage.scene.camera.rays_through(centres)
        lamps = [math.dist(point.light.position, origin[0].tolist()) for point in stage.lighting.points]
        edges = self.edges(float(stage.rays.distance.max()), lamps)
        source, extinction = [], []
        for front, back in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            parts = [
                self._measure_cells(stage, part_origin + front * part_direction, part_direction, back - front)
                for part_origin, part_direction in zip(
                    origin.split(CELLS_AT_ONCE), direction.split(CELLS_AT_ONCE), strict=True
                )
            ]
            source.append(torch.cat([part[0] for part in parts]).reshape(height, width, 3))
            extinction.append(torch.cat([part[1] for part in parts]).reshape(height, width, 3))
        return accumulate_froxels(edges, torch.stack(source), torch.stack(extinction))

    def _measure_cells(self, stage: Stage, front: Tensor, direction: Tensor, length: float) -> tuple[Tensor, Tensor]:
        """Source and extinction `(cell, channel)` [1/m] of cells of one length [m]."""
        rays = ViewRays(front, direction, torch.full_like(front[:, 0], length))
        borders = torch.stack([torch.zeros_like(rays.distance), rays.distance], dim=1)
        marched = march(stage.scene.air, stage.lighting, rays, borders, looks=self.looks)
        return marched.in_scattering / (length * mean_transmittance(marched.depth)), marched.depth / length

    def refined(self) -> Self:
        """Twice as many cells along each ray, and blocks of two thirds of the edge."""
        return replace(self, cells=2 * self.cells, factor=max(1, (2 * self.factor) // 3))

    def at_full_density(self, steps: int) -> "Froxels":
        """A column for every pixel, of so many equal cells."""
        return Froxels(steps, 1, 1.0, 0.0, ShadowLooks())
