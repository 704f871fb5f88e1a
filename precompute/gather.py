"""From source points to pixels: the camera-ray integral as a sparse, linear map.

For an extinction s the radiance scattered towards pixel q is an integral over the share of the ray that is absorbed,

    f(q) = integral of s rho exp(-s u) J dt = integral over a from 0 to 1 - T(q, s) of J(x(a)) da,    a = 1 - exp(-s u)

so midpoints of equal strata of `a` resolve a thick cloud's surface as well as a thin one's whole depth. J is interpolated
trilinearly between lattice points. Each pixel thus becomes a bag of (point, weight) pairs.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from render.density_grid import DensityGrid
from render.ray_march import interpolate_in_rows, locate_in_rows, march_rays, ray_chunks


@dataclass(frozen=True, eq=False)
class Lattice:
    """Regular lattice of candidate source points.

    Args:
        corner: position of the first point `(3,)` x, y, z [m].
        spacing: distances of the points along x, y, z `(3,)` [m].
        counts: points along x, y, z.
    """

    corner: Tensor
    spacing: Tensor
    counts: tuple[int, int, int]

    @property
    def size(self) -> int:
        """Number of lattice points."""
        return self.counts[0] * self.counts[1] * self.counts[2]

    def positions(self, index: Tensor) -> Tensor:
        """Positions `(point, 3)` [m] of points by number."""
        nx, ny, _ = self.counts
        xyz = torch.stack([index % nx, index // nx % ny, index // (nx * ny)], dim=-1)
        return self.corner + xyz * self.spacing

    def corners(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Numbers and trilinear weights, each `(..., 8)`, of the lattice points around positions `(..., 3)` [m]."""
        coordinate = (points - self.corner) / self.spacing
        last = torch.tensor([max(n - 2, 0) for n in self.counts], dtype=coordinate.dtype)
        cell = coordinate.floor().clamp(min=0.0).minimum(last)
        fraction = (coordinate - cell).clamp(0.0, 1.0)
        base = cell.long()
        nx, ny, _ = self.counts
        numbers, weights = [], []
        for dz in (0, 1):
            for dy in (0, 1):
                for dx in (0, 1):
                    offset = torch.tensor([dx, dy, dz])
                    x, y, z = torch.minimum(base + offset, torch.tensor(self.counts) - 1).unbind(-1)
                    numbers.append((z * ny + y) * nx + x)
                    weights.append(torch.where(offset.bool(), fraction, 1.0 - fraction).prod(-1))
        return torch.stack(numbers, dim=-1), torch.stack(weights, dim=-1)


def lattice_over(grid: DensityGrid, stretch: float) -> Lattice:
    """Lattice over the box of a volume whose points lie about `stretch` voxels apart, the outer ones half a spacing inside."""
    extent = grid.upper - grid.lower
    cells = torch.round(extent / (grid.voxel_size * stretch)).clamp(min=1.0)
    nx, ny, nz = (int(n) for n in cells)
    spacing = extent / cells
    return Lattice(grid.lower + 0.5 * spacing, spacing, (nx, ny, nz))


@dataclass(frozen=True, eq=False)
class Bags:
    """Lattice points and weights that make up a run of pixels at one extinction.

    Args:
        rays: which rays.
        extinction: which node.
        numbers: lattice points `(ray, entry)`.
        weights: of each entry `(ray, entry)`; they sum to the ray's opacity.
    """

    rays: slice
    extinction: int
    numbers: Tensor
    weights: Tensor


def gather_bags(
    grid: DensityGrid, lattice: Lattice, origin: Tensor, direction: Tensor, extinction: Tensor, strata: int
) -> Iterator[Bags]:
    """Bags of every ray and extinction, a bounded run of rays at a time.

    Args:
        grid: the volume.
        lattice: of the source points.
        origin: ray origins `(ray, 3)` [m].
        direction: unit directions `(ray, 3)`.
        extinction: nodes `(extinction,)` [1/m].
        strata: positions along each ray.
    """
    midpoints = (torch.arange(strata, dtype=torch.float64) + 0.5) / strata
    for rays in ray_chunks(grid, len(origin)):
        profile = march_rays(grid, origin[rays], direction[rays])
        for node, s in enumerate(extinction.double()):
            opacity = -torch.expm1(-s * profile.total.double())
            target = (-torch.log1p(-midpoints * opacity[:, None]) / s).to(torch.float32)
            distance = interpolate_in_rows(profile.distance, *locate_in_rows(profile.optical_length, target))
            points = origin[rays, None] + distance[..., None] * direction[rays, None]
            numbers, weights = lattice.corners(points)
            weights = weights * (opacity[:, None, None] / strata).to(torch.float32)
            yield Bags(rays, node, numbers.flatten(1), weights.flatten(1))
