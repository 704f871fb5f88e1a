"""What is rendered: a volume, a camera and a sun."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from render.camera import Camera, direction_from_angles
from render.density_grid import DensityGrid


@dataclass(frozen=True, eq=False)
class Scene:
    """The scene that every photograph of a batch is fitted with.

    Args:
        grid: density volume.
        volume: file it came from, or None for the procedural cumulus.
        camera: full-size view of the pictures.
        sun_azimuth: direction of the sun [rad, clockwise from north].
        sun_elevation: height of the sun above the horizon [rad].
    """

    grid: DensityGrid
    volume: Path | None
    camera: Camera
    sun_azimuth: float
    sun_elevation: float

    @cached_property
    def sun_direction(self) -> Tensor:
        """Unit vector towards the sun `(3,)`."""
        return torch.tensor(direction_from_angles(self.sun_azimuth, self.sun_elevation), dtype=torch.float32)
