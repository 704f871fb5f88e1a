"""Small volumes with known integrals, and the directions from which they are seen and lit."""

import math

import torch
from torch import Tensor

from render.camera import OrthographicCamera, direction_from_angles
from render.density_grid import DensityGrid


def uniform_box(
    extent: tuple[float, float, float] = (4.0, 5.0, 6.0), voxels: tuple[int, int, int] = (4, 5, 6), density: float = 1.0
) -> DensityGrid:
    """Box of one density, centred on the origin; extent [m] and voxels along x, y, z."""
    upper = 0.5 * torch.tensor(extent)
    return DensityGrid(torch.full(voxels[::-1], density), -upper, upper)


def ramp_box(length: float = 8.0, voxels: int = 16, slope: float = 0.25) -> DensityGrid:
    """Box of 8 x 2 x 2 m from x = 0 whose density is slope times x between the outer voxel centres, and held beyond."""
    centres = (torch.arange(voxels) + 0.5) * length / voxels
    density = (slope * centres).expand(2, 2, voxels)
    return DensityGrid(density, torch.tensor([0.0, -1.0, -1.0]), torch.tensor([length, 1.0, 1.0]))


def noise_box(voxels: int = 6, seed: int = 1, sparse: float = 0.0) -> DensityGrid:
    """Cube of voxels of 1 m with independent uniform densities, a share of them empty."""
    generator = torch.Generator().manual_seed(seed)
    density = torch.rand(voxels, voxels, voxels, generator=generator)
    empty = torch.rand(voxels, voxels, voxels, generator=generator) < sparse
    return DensityGrid.from_voxel_size(torch.where(empty, 0.0, density), 1.0)


def smooth_box(voxels: int = 16, size: float = 16.0, seed: int = 2) -> DensityGrid:
    """Cube of the given size [m] whose density is a few random waves, between about 0 and 1: noise that a voxel resolves."""
    generator = torch.Generator().manual_seed(seed)
    centres = (torch.arange(voxels) + 0.5) / voxels
    z, y, x = torch.meshgrid(centres, centres, centres, indexing="ij")
    density = torch.full((voxels, voxels, voxels), 0.5)
    for _ in range(6):
        waves = 1.5 * (2.0 * torch.rand(3, generator=generator) - 1.0)
        phase = torch.rand(1, generator=generator)
        density += 0.15 * torch.sin(2.0 * math.pi * (waves[0] * x + waves[1] * y + waves[2] * z + phase))
    return DensityGrid.from_voxel_size(density.clamp(min=0.0), size / voxels)


def scaled(grid: DensityGrid, factor: float) -> DensityGrid:
    """The same cloud with all lengths times a factor."""
    return DensityGrid(grid.density, grid.lower * factor, grid.upper * factor)


def towards(azimuth_deg: float, elevation_deg: float) -> Tensor:
    """Unit vector `(3,)` of an azimuth clockwise from north and an elevation."""
    return torch.tensor(direction_from_angles(math.radians(azimuth_deg), math.radians(elevation_deg)))


def view_north(width: int = 1, height: int = 1, view_height: float = 1.0, distance: float = 50.0) -> OrthographicCamera:
    """Parallel view along +y at the origin."""
    return OrthographicCamera((0.0, -distance, 0.0), (0.0, 0.0, 0.0), view_height, width, height)


def random_rays(grid: DensityGrid, count: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Origins [m] on a sphere around a volume and unit directions towards points within it, each `(ray, 3)`."""
    generator = torch.Generator().manual_seed(seed)
    outwards = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    origin = grid.centre + 1.5 * grid.radius * outwards
    target = grid.lower + torch.rand(count, 3, generator=generator) * (grid.upper - grid.lower)
    return origin, torch.nn.functional.normalize(target - origin, dim=-1)
