"""The rays of a camera that see cloud."""

from dataclasses import dataclass

import torch
from torch import Tensor

from render.camera import Camera, unit_direction
from render.density_grid import DensityGrid
from render.ray_march import compute_optical_length


@dataclass(frozen=True, eq=False)
class View:
    """Volume, camera, sun, and the rays that see cloud.

    Args:
        grid: the volume.
        camera: the rays' origin.
        sun: unit vector towards the sun `(3,)`.
        pixel: numbers of the pixels that see cloud `(ray,)`.
        origin, direction: of their rays `(ray, 3)` [m], unit vectors.
        optical_length: along each `(ray,)` [m].
    """

    grid: DensityGrid
    camera: Camera
    sun: Tensor
    pixel: Tensor
    origin: Tensor
    direction: Tensor
    optical_length: Tensor

    @property
    def largest_optical_length(self) -> float:
        """Of any ray [m]; zero without cloud."""
        return float(self.optical_length.max()) if len(self.pixel) else 0.0

    def part(self, rays: Tensor) -> "View":
        """The same with some of the rays."""
        return View(
            self.grid,
            self.camera,
            self.sun,
            self.pixel[rays],
            self.origin[rays],
            self.direction[rays],
            self.optical_length[rays],
        )


def view_of(grid: DensityGrid, camera: Camera, sun_direction: Tensor) -> View:
    """Rays of a camera that see cloud. Raises ParameterError for a sun vector `(3,)` without direction."""
    origin, direction = camera.rays()
    optical_length = compute_optical_length(grid, origin, direction)
    pixel = torch.nonzero(optical_length > 0).flatten()
    sun = unit_direction(sun_direction)
    return View(grid, camera, sun, pixel, origin[pixel], direction[pixel], optical_length[pixel])
