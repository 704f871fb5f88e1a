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
from render.ray_march import RayProfile, interpolate_in_rows, locate_in_rows

BAG_POSITIONS = 1 << 17
"""Positions along rays whose bags are made at once; bounds the memory."""


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
        last = torch.tensor(self.counts) - 1
        cell = coordinate.int().clamp(min=0).minimum((last - 1).clamp(min=0).int())
        fraction = (coordinate - cell).clamp(0.0, 1.0)
        strides = torch.tensor([1, self.counts[0], self.counts[0] * self.counts[1]], dtype=torch.int32)
        low = cell * strides
        # Where an axis has one point only, both corners are that one.
        ends = torch.stack([low, low + strides * last.clamp(max=1).int()], dim=-1)
        shares = torch.stack([1.0 - fraction, fraction], dim=-1)
        x, y, z = ends.unbind(-2)
        numbers = z[..., :, None, None] + y[..., None, :, None] + x[..., None, None, :]
        x, y, z = shares.unbind(-2)
        weights = z[..., :, None, None] * (y[..., :, None] * x[..., None, :])[..., None, :, :]
        return numbers.flatten(-3), weights.flatten(-3)


def lattice_over(grid: DensityGrid, stretch: float, shift: float = 0.0) -> Lattice:
    """Lattice over the box of a volume.

    Args:
        grid: the volume.
        stretch: distance of the points in voxels, about.
        shift: of all points along each axis in spacings, from where the outer ones lie half a spacing inside.
    """
    extent = grid.upper - grid.lower
    cells = torch.round(extent / (grid.voxel_size * stretch)).clamp(min=1.0)
    nx, ny, nz = (int(n) for n in cells)
    spacing = extent / cells
    return Lattice(grid.lower + (0.5 + shift) * spacing, spacing, (nx, ny, nz))


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


@dataclass(frozen=True, eq=False)
class Strata:
    """Positions along rays at the midpoints of equal strata of the absorbed share.

    Each ray is marched once, for single scattering, and `cut` makes the strata of the profiles that come up there.

    Args:
        distance: from the rays' origins `(extinction, ray, stratum)` [m].
        opacity: of each ray `(extinction, ray)`.
    """

    distance: Tensor
    opacity: Tensor

    @classmethod
    def uncut(cls, extinctions: int, rays: int, strata: int) -> "Strata":
        """Room for the strata of rays at every extinction."""
        return cls(torch.empty(extinctions, rays, strata), torch.empty(extinctions, rays))

    def cut(self, extinction: Tensor, rays: slice, profile: RayProfile) -> None:
        """Fill in some of the rays.

        Args:
            extinction: nodes `(extinction,)` [1/m].
            rays: which they are.
            profile: of these rays.
        """
        count = self.distance.shape[2]
        midpoints = (torch.arange(count, dtype=torch.float64) + 0.5) / count
        for node, s in enumerate(extinction.double()):
            absorbed = -torch.expm1(-s * profile.total.double())
            target = (-torch.log1p(-midpoints * absorbed[:, None]) / s).to(torch.float32)
            place = locate_in_rows(profile.optical_length, target)
            self.distance[node, rays] = interpolate_in_rows(profile.distance, *place)
            self.opacity[node, rays] = absorbed.to(torch.float32)

    def part(self, rays: Tensor) -> "Strata":
        """The same for some of the rays."""
        return Strata(self.distance[:, rays], self.opacity[:, rays])

    def at(self, node: int) -> "Strata":
        """The same for one extinction."""
        return Strata(self.distance[node : node + 1], self.opacity[node : node + 1])


def gather_bags(lattice: Lattice, origin: Tensor, direction: Tensor, strata: Strata) -> Iterator[Bags]:
    """Bags of every ray and extinction, a bounded run of rays at a time.

    Args:
        lattice: of the source points.
        origin: ray origins `(ray, 3)` [m].
        direction: unit directions `(ray, 3)`.
        strata: of these rays.
    """
    count = strata.distance.shape[2]
    size = max(1, BAG_POSITIONS // count)
    for node, (distance, opacity) in enumerate(zip(strata.distance, strata.opacity, strict=True)):
        for first in range(0, len(origin), size):
            rays = slice(first, min(first + size, len(origin)))
            points = origin[rays, None] + distance[rays, :, None] * direction[rays, None]
            numbers, weights = lattice.corners(points)
            weights = weights * (opacity[rays, None, None] / count)
            yield Bags(rays, node, numbers.flatten(1), weights.flatten(1))
