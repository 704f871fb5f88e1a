"""A cloud as a regular grid of densities in an axis-aligned box."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from render.errors import VolumeError
from render.trilinear import TrilinearTable


@dataclass(frozen=True, eq=False)
class DensityGrid:
    """Density samples at the centres of the voxels of a box, interpolated trilinearly, zero outside the box.

    In the outer half voxel the nearest sample is held, as Mitsuba's `gridvolume` does. The extinction coefficient of the
    cloud is `extinction` [1/m] times this dimensionless density.

    Args:
        density: samples `(z, y, x)`, finite and not negative, dimensionless.
        lower: corner of the box with the smallest coordinates `(3,)` x, y, z [m].
        upper: corner with the largest coordinates `(3,)` [m].

    Raises:
        VolumeError: for a wrong shape, NaN, infinite or negative densities, or a box without extent.
    """

    density: Tensor
    lower: Tensor
    upper: Tensor

    def __post_init__(self) -> None:
        density = torch.as_tensor(self.density)
        if density.ndim != 3 or density.numel() == 0:
            raise VolumeError(f"a density needs the shape (z, y, x) without empty axes, not {tuple(density.shape)}")
        density = density.to(torch.float32).contiguous()
        if not torch.isfinite(density).all():
            count = int((~torch.isfinite(density)).sum())
            raise VolumeError(f"the density holds {count} NaN or infinite values; every voxel must be finite")
        if density.min() < 0:
            raise VolumeError(f"the density falls to {float(density.min()):.4g}; it must not be negative")
        lower = torch.as_tensor(self.lower, dtype=torch.float32, device=density.device)
        upper = torch.as_tensor(self.upper, dtype=torch.float32, device=density.device)
        if lower.shape != (3,) or upper.shape != (3,) or not torch.isfinite(torch.cat([lower, upper])).all():
            raise VolumeError(f"the box needs two finite corners (x, y, z), not {lower.tolist()} and {upper.tolist()}")
        if not (upper > lower).all():
            raise VolumeError(f"the box from {lower.tolist()} to {upper.tolist()} has no extent along some axis")
        object.__setattr__(self, "density", density)
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)

    @classmethod
    def from_voxel_size(
        cls, density: Tensor, voxel_size: float | Sequence[float], lower: Sequence[float] | None = None
    ) -> "DensityGrid":
        """Grid from the edge length of its voxels [m], one number or (x, y, z); centred on the origin without `lower`."""
        if density.ndim != 3:
            raise VolumeError(f"a density needs the shape (z, y, x), not {tuple(density.shape)}")
        counts = torch.tensor(list(reversed(density.shape)), dtype=torch.float32)
        size = counts * torch.as_tensor(voxel_size, dtype=torch.float32)
        corner = -0.5 * size if lower is None else torch.as_tensor(lower, dtype=torch.float32)
        return cls(density, corner, corner + size)

    @cached_property
    def voxel_size(self) -> Tensor:
        """Edge lengths of a voxel `(3,)` x, y, z [m]."""
        counts = torch.tensor(list(reversed(self.density.shape)), dtype=torch.float32, device=self.density.device)
        return (self.upper - self.lower) / counts

    @property
    def centre(self) -> Tensor:
        """Middle of the box `(3,)` [m]."""
        return 0.5 * (self.lower + self.upper)

    @property
    def radius(self) -> float:
        """Radius of the sphere around the box [m]."""
        return 0.5 * float(torch.linalg.vector_norm(self.upper - self.lower))

    @cached_property
    def maximum(self) -> float:
        """Largest density; the majorant of delta tracking."""
        return float(self.density.max())

    @cached_property
    def visible_points(self) -> Tensor:
        """Centres of the voxels denser than one per cent of the maximum `(point, 3)` [m]; what a camera should frame."""
        z, y, x = torch.nonzero(self.density > 0.01 * self.maximum).unbind(-1)
        return self.lower + (torch.stack([x, y, z], dim=-1) + 0.5) * self.voxel_size

    @cached_property
    def table(self) -> TrilinearTable:
        """The samples as a table whose coordinates are voxel numbers."""
        return TrilinearTable(self.density)

    def voxel_coordinates(self, points: Tensor) -> Tensor:
        """Coordinates `(..., 3)` x, y, z in voxels of points [m]; whole numbers are voxel centres."""
        return (points - self.lower) / self.voxel_size - 0.5

    def look_up_density(self, points: Tensor) -> Tensor:
        """Density at points.

        Args:
            points: positions `(..., 3)` [m].

        Returns:
            Densities `(...)`, zero outside the box.
        """
        x, y, z = self.voxel_coordinates(points).unbind(-1)
        inside = ((points >= self.lower) & (points <= self.upper)).all(-1)
        return torch.where(inside, self.table.look_up(x, y, z), 0.0)

    def intersect(self, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """Distances at which rays enter and leave the box (slab method).

        Args:
            origin: ray origins `(ray, 3)` [m]. A ray that starts inside enters at distance 0.
            direction: unit directions `(ray, 3)`; components may be zero.

        Returns:
            `(near, far)`, each `(ray,)` [m], with `far <= near` for rays that miss; a ray that misses has `near == far`.
        """
        # The inverse of anything smaller overflows, and infinity times zero is no number.
        parallel = direction.abs() < torch.finfo(direction.dtype).tiny
        inverse = 1.0 / torch.where(parallel, 1.0, direction)
        first, second = (self.lower - origin) * inverse, (self.upper - origin) * inverse
        within = (origin >= self.lower) & (origin <= self.upper)
        unbounded = torch.where(within, torch.inf, -torch.inf)
        near = torch.where(parallel, -unbounded, torch.minimum(first, second)).amax(-1).clamp_(min=0.0)
        far = torch.where(parallel, unbounded, torch.maximum(first, second)).amin(-1)
        hit = far > near
        return torch.where(hit, near, 0.0), torch.where(hit, far, 0.0)
