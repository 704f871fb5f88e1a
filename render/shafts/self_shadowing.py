"""How much of a medium lies between any point and a light, as a table: the shadow that the medium casts on itself.

The optical length to the light, integral of density dt [m], is marched once from every corner of the voxels; a look-up replaces
a march at every step of every camera ray. Times the extinction it is the optical depth. From a point outside of the box the way to
the light enters the box somewhere or not at all, so such a point looks up the place of entry.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.camera import Vector
from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.trilinear import TrilinearTable

STEP = 0.5
"""Step towards the light, in the shortest edge of a voxel."""

SAMPLES_IN_FLIGHT = 1 << 20
"""Samples on the way to the light at once: bounds the memory."""


@dataclass(frozen=True)
class DistantLight:
    """A light at infinity, such as the sun.

    Args:
        towards: vector towards it, of any length.

    Raises:
        ParameterError: for a vector that is zero or not finite.
    """

    towards: Vector

    def __post_init__(self) -> None:
        if not 0.0 < math.hypot(*self.towards) < math.inf:
            raise ParameterError(f"the vector towards a light must be finite and not zero, not {self.towards}")

    def way_from(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Unit directions `(point, 3)` towards the light, and distances `(point,)` [m], which are infinite."""
        vector = torch.tensor(self.towards, dtype=torch.float64)
        direction = (vector / torch.linalg.vector_norm(vector)).to(points)
        return direction.expand_as(points), torch.full_like(points[:, 0], torch.inf)


@dataclass(frozen=True)
class NearLight:
    """A light at a point.

    Args:
        position: where it is [m].

    Raises:
        ParameterError: for a position that is not finite.
    """

    position: Vector

    def __post_init__(self) -> None:
        if not math.isfinite(sum(self.position)):
            raise ParameterError(f"the position of a light must be finite, not {self.position}")

    def way_from(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Unit directions `(point, 3)` towards the light, and distances `(point,)` [m]; upwards from the light itself."""
        offset = torch.tensor(self.position, dtype=points.dtype, device=points.device) - points
        distance = torch.linalg.vector_norm(offset, dim=1)
        up = torch.tensor([0.0, 0.0, 1.0], dtype=points.dtype, device=points.device)
        direction = offset / torch.where(distance > 0.0, distance, 1.0)[:, None]
        return torch.where(distance[:, None] > 0.0, direction, up), distance


Light = DistantLight | NearLight


@dataclass(frozen=True, eq=False)
class LightLengths:
    """Optical lengths from the corners of the voxels of a medium to a light.

    Args:
        light: the light.
        grid: the medium.
        table: optical length at each corner `(z + 1, y + 1, x + 1)` [m].
    """

    light: Light
    grid: DensityGrid
    table: TrilinearTable

    def look_up(self, points: Tensor) -> Tensor:
        """Optical length from points `(point, 3)` [m] to the light `(point,)` [m]; 0 where nothing lies between."""
        precision, points = points.dtype, points.to(torch.float32)
        direction, distance = self.light.way_from(points)
        near, far = self.grid.intersect(points, direction)
        meets = (far > near) & (near < distance)
        entry = points + torch.where(meets, near, 0.0)[:, None] * direction
        x, y, z = (self.grid.voxel_coordinates(entry) + 0.5).unbind(-1)
        return torch.where(meets, self.table.look_up(x, y, z), 0.0).to(precision)


def compute_light_length(grid: DensityGrid, points: Tensor, light: Light, step: float = STEP) -> Tensor:
    """Optical length from points to a light, by marching.

    Args:
        grid: the medium.
        points: positions `(point, 3)` [m].
        light: the light.
        step: longest step, in the shortest edge of a voxel.

    Returns:
        Optical lengths `(point,)` [m]; trapezoids, summed in float64.
    """
    precision, points = points.dtype, points.to(torch.float32)
    direction, distance = light.way_from(points)
    return compute_length_along(grid, points, direction, distance, step).to(precision)


def compute_length_along(
    grid: DensityGrid, points: Tensor, direction: Tensor, distance: Tensor, step: float = STEP
) -> Tensor:
    """Optical length of stretches of rays.

    Args:
        grid: the medium.
        points: where they begin `(point, 3)` [m].
        direction: unit vectors `(point, 3)`.
        distance: their lengths `(point,)` [m]; may be infinite.
        step: longest step, in the shortest edge of a voxel.

    Returns:
        Optical lengths `(point,)` [m]; trapezoids, summed in float64.
    """
    precision = points.dtype
    points, direction, distance = (part.to(torch.float32) for part in (points, direction, distance))
    near, far = grid.intersect(points, direction)
    length = (torch.minimum(far, distance) - near).clamp(min=0.0)
    longest = float(length.max()) if len(points) else 0.0
    steps = max(1, math.ceil(longest / (step * float(grid.voxel_size.min()))))
    fraction = torch.arange(steps + 1, dtype=points.dtype, device=points.device) / steps
    weight = torch.ones(steps + 1, dtype=torch.float64, device=points.device)
    weight[0] = weight[-1] = 0.5
    result = torch.zeros_like(length)
    for part in torch.nonzero(length > 0.0)[:, 0].split(max(1, SAMPLES_IN_FLIGHT // (steps + 1))):
        way = near[part, None] + length[part, None] * fraction
        start, rate = grid.voxel_coordinates(points[part]), direction[part] / grid.voxel_size
        x, y, z = (start[:, None, axis] + way * rate[:, None, axis] for axis in range(3))
        mean = (grid.table.look_up(x, y, z).double() @ weight) / steps
        result[part] = (mean * length[part]).to(result.dtype)
    return result.to(precision)


def build_light_lengths(grid: DensityGrid, light: Light, step: float = STEP) -> LightLengths:
    """Table of optical lengths from the corners of all voxels to a light.

    Args:
        grid: the medium.
        light: the light.
        step: longest step of the march, in the shortest edge of a voxel.

    Returns:
        The table.
    """
    axes = [torch.arange(count + 1, device=grid.density.device, dtype=torch.float32) for count in grid.density.shape]
    z, y, x = torch.meshgrid(*axes, indexing="ij")
    points = grid.lower + torch.stack([x, y, z], dim=-1).reshape(-1, 3) * grid.voxel_size
    # Rounding must not put a corner outside of the box, where a ray along a face would miss it.
    points = torch.minimum(points, grid.upper)
    lengths = compute_light_length(grid, points, light, step).reshape(z.shape)
    return LightLengths(light, grid, TrilinearTable(lengths))
