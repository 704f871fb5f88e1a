"""The lattice on which light is carried from order to order: the points around the cloud's density, and their neighbours."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from precompute.gather import Lattice, lattice_over
from render.density_grid import DensityGrid

MEAN_SPREAD = torch.tensor([1.0 / 12.0])
"""Half of w (1 - w) on average over a cell, for places that are anywhere."""


@dataclass(frozen=True, eq=False)
class LightLattice:
    """Points of a lattice that light inside a volume is interpolated from.

    Args:
        lattice: over the volume's box.
        numbers: of the points in the lattice `(point,)`.
        entry: number of each lattice point among the points `(lattice point,)` int32; zero for those that are none.
        neighbours: among the points, before and after along x, y and z `(point, 6)` int32; the point itself where one is missing.
    """

    lattice: Lattice
    numbers: Tensor
    entry: Tensor
    neighbours: Tensor

    @property
    def positions(self) -> Tensor:
        """Of the points `(point, 3)` [m]."""
        return self.lattice.positions(self.numbers)

    def sharpen(self, values: Tensor, spread: Tensor = MEAN_SPREAD) -> Tensor:
        """Values `(point, column)` less the second differences along all axes times the spread `(point,)` at each point.

        Interpolation at a share w of the way from point to point widens what it interpolates by w (1 - w) h^2; half the mean of w (1 - w)
        over all places near a point makes up for it, so that many interpolations in a row neither spread light nor let it leak.
        """
        around = sum(values[neighbour] for neighbour in self.neighbours.unbind(1))
        return values * (1.0 + 6.0 * spread[:, None]) - spread[:, None] * around

    def measure_spread(self, positions: Iterable[Tensor]) -> Tensor:
        """Half the mean of w (1 - w) over places `(place, 3)` [m] around each point, and over the axes: `(point,)`, at most 1/8."""
        wide, all_ = torch.zeros(len(self.numbers)), torch.full((len(self.numbers),), 1e-30)
        for places in positions:
            numbers, weights = self.corners(places)
            share = (places - self.lattice.corner) / self.lattice.spacing % 1.0
            spread = 0.5 * (share * (1.0 - share)).mean(1, keepdim=True)
            wide.index_add_(0, numbers.flatten(), (weights * spread).flatten())
            all_.index_add_(0, numbers.flatten(), weights.flatten())
        return wide / all_

    def corners(self, position: Tensor) -> tuple[Tensor, Tensor]:
        """Points around positions `(..., 3)` [m], int32, and their weights, each `(..., 8)`."""
        numbers, weights = self.lattice.corners(position)
        return self.entry[numbers], weights

    def interpolate(self, values: Tensor, position: Tensor) -> Tensor:
        """Sharpened values `(point, column)` at positions `(position, 3)` [m]: `(position, column)`."""
        numbers, weights = self.corners(position)
        return embedding_bag(numbers, values, per_sample_weights=weights, mode="sum")


def light_lattice_over(grid: DensityGrid, spacing: float, points: int, shift: float = 0.0) -> LightLattice:
    """Lattice with about a spacing, or as fine as a number of points allows.

    Args:
        grid: the volume.
        spacing: wanted distance of the points, at least one [voxel].
        points: at most, about.
        shift: of all of them along each axis, in spacings.
    """
    stretch = max(spacing, 1.0)
    for _ in range(4):
        lattice = lattice_over(grid, stretch, shift)
        needed = _around_density(grid, lattice)
        if int(needed.sum()) <= 1.1 * points:
            break
        stretch *= 1.02 * (int(needed.sum()) / points) ** (1.0 / 3.0)
    return number_points(lattice, needed.flatten())


def _around_density(grid: DensityGrid, lattice: Lattice) -> Tensor:
    """Which lattice points are corners of a cell that holds density `(z, y, x)`: axis by axis, since a voxel reaches one voxel far."""
    held = (grid.density > 0).float()
    for axis in range(3):
        voxels = grid.density.shape[2 - axis]
        centre = (torch.arange(voxels) + 0.5) * grid.voxel_size[axis]
        reach = torch.stack([centre - grid.voxel_size[axis], centre + grid.voxel_size[axis]])
        place = (reach - (lattice.corner - grid.lower)[axis]) / lattice.spacing[axis]
        low, high = place[0].floor(), place[1].floor() + 1
        number = torch.arange(lattice.counts[axis])
        last = lattice.counts[axis] - 1
        # Positions beyond the outermost points are held at them.
        touched = (number[:, None] >= low.clamp(max=last)) & (number[:, None] <= high.clamp(min=0))
        held = torch.movedim(torch.tensordot(touched.float(), held, dims=([1], [2 - axis])), 0, 2 - axis)
        held = (held > 0).float()
    return held > 0


def number_points(lattice: Lattice, needed: Tensor) -> LightLattice:
    """The points of a lattice that are needed `(lattice point,)`, with their neighbours."""
    numbers = torch.nonzero(needed).flatten()
    entry = torch.zeros(lattice.size, dtype=torch.int32)
    entry[numbers] = torch.arange(len(numbers), dtype=torch.int32)
    own = torch.arange(len(numbers), dtype=torch.int32)
    neighbours, stride = [], 1
    for count in lattice.counts:
        place = numbers // stride % count
        before, after = (numbers - stride).clamp(min=0), (numbers + stride).clamp(max=lattice.size - 1)
        inner = (place > 0) & (place < count - 1) & needed[before] & needed[after]
        neighbours += [torch.where(inner, entry[before], own), torch.where(inner, entry[after], own)]
        stride *= count
    return LightLattice(lattice, numbers, entry, torch.stack(neighbours, dim=1).contiguous())


def spacing_for(grid: DensityGrid, extinction: float, depth: float) -> float:
    """Distance of lattice points in voxels at which the densest cell has an optical depth."""
    voxel_depth = extinction * grid.maximum * float(grid.voxel_size.min())
    return depth / voxel_depth if voxel_depth > 0.0 else math.inf
