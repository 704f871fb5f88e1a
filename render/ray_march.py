"""Deterministic line integrals of the density: the optical length that every other quantity is a function of.

The optical length u = integral of density dt [m] times the extinction [1/m] is the optical depth. Steps are trapezoids, so the
density is taken as linear within each step and the optical length as the quadratic that belongs to it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from render.density_grid import DensityGrid
from render.free_flight import fly

CAMERA_STEP = 0.5
"""Step along camera and sun rays, in voxels."""

PROFILE_SAMPLES = 1 << 20
"""Samples in flight at once while marching: bounds the memory."""

RAYS_AT_ONCE = 1 << 17
"""Whole rays likewise, of which a few samples each are held."""


@dataclass(frozen=True, eq=False)
class RayProfile:
    """Optical length along rays, at equidistant edges between entering and leaving the box.

    Args:
        distance: of the edges from the ray origins `(ray, edge)` [m].
        optical_length: from the origin to each edge `(ray, edge)` [m], starts at zero, never falls.
    """

    distance: Tensor
    optical_length: Tensor

    @property
    def total(self) -> Tensor:
        """Optical length of the whole ray `(ray,)` [m]."""
        return self.optical_length[:, -1]


def march_rays(grid: DensityGrid, origin: Tensor, direction: Tensor, step: float = CAMERA_STEP) -> RayProfile:
    """Optical length along rays through the whole box.

    Args:
        grid: the volume.
        origin: ray origins `(ray, 3)` [m].
        direction: unit directions `(ray, 3)`.
        step: length of a step in voxels (of the shortest edge).

    Returns:
        The profile; rays that miss have zero length everywhere.
    """
    near, far = grid.intersect(origin, direction)
    stride = step * float(grid.voxel_size.min())
    steps = max(1, int(torch.ceil((far - near).max() / stride))) if near.numel() else 1
    fraction = torch.linspace(0.0, 1.0, steps + 1, device=origin.device)
    distance = near[:, None] + (far - near)[:, None] * fraction
    start, rate = grid.voxel_coordinates(origin), direction / grid.voxel_size
    x, y, z = (start[:, None, axis] + distance * rate[:, None, axis] for axis in range(3))
    density = grid.table.look_up(x, y, z).double()
    length = ((far - near) / steps).double()[:, None]
    increments = 0.5 * length * (density[:, :-1] + density[:, 1:])
    cumulative = torch.nn.functional.pad(increments.cumsum(1), (1, 0))
    return RayProfile(distance, cumulative.to(torch.float32))


def ray_chunks(grid: DensityGrid, rays: int, step: float = CAMERA_STEP) -> Iterator[slice]:
    """Slices of rays whose profiles fit the memory bound together."""
    samples = 2.0 * grid.radius / (step * float(grid.voxel_size.min())) + 1.0
    size = max(1, int(PROFILE_SAMPLES / samples))
    for first in range(0, rays, size):
        yield slice(first, min(first + size, rays))


def compute_optical_length(grid: DensityGrid, origin: Tensor, direction: Tensor, step: float = CAMERA_STEP) -> Tensor:
    """Optical length of whole rays `(ray,)` [m]; arguments as for `march_rays`, whose steps all rays share, while each has its own here."""
    parts = [
        fly(grid, *part, torch.full_like(part[0][:, 0], math.inf), step).optical_length
        for part in zip(origin.split(RAYS_AT_ONCE), direction.split(RAYS_AT_ONCE), strict=True)
    ]
    return torch.cat(parts) if parts else origin.new_zeros(0)


def locate_in_rows(known: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Cell and fraction at which each row of rising values reaches its targets.

    Args:
        known: never falling along each row `(ray, edge)`.
        target: values to look for `(ray, target)`, from the row's first value up.

    Returns:
        Number of the edge before each target, and the fraction of the way to the next `(ray, target)`. A target that a row
        reaches on a flat stretch is located at the end of the stretch.
    """
    after = torch.searchsorted(known.contiguous(), target.contiguous(), right=True).clamp(1, known.shape[1] - 1)
    cell = after - 1
    low, high = known.gather(1, cell), known.gather(1, after)
    return cell, ((target - low) / (high - low).clamp(min=1e-30)).clamp(0.0, 1.0)


def interpolate_in_rows(values: Tensor, cell: Tensor, fraction: Tensor) -> Tensor:
    """Values `(ray, target)` at places found by `locate_in_rows`, linear between the edges of `values` `(ray, edge)`."""
    low = values.gather(1, cell)
    return low + fraction.to(values.dtype) * (values.gather(1, cell + 1) - low)
