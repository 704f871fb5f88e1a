"""Free flights with a known optical length: march until a drawn optical length is used up.

Delta tracking would not do here: one path serves every extinction of the table (`path_sampler`), so the optical length of each leg
must be a number that the density alone defines.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from render.density_grid import DensityGrid
from render.fused import fused_loops_wanted

DARKEST_DEPTH = 20.0
"""Optical depth to the sun beyond which a point counts as unlit, even at the smallest extinction of a group: exp(-20) is 2e-9."""

BLOCK = 8
"""Steps taken at once before finished paths are removed: fewer, larger tensor operations against a few wasted steps."""


@dataclass(frozen=True, eq=False)
class Flight:
    """Ends of free flights.

    Args:
        collided: whether the flight ended inside the volume `(ray,)`.
        position: where it ended `(ray, 3)` [m]; for flights that left the volume, where it entered.
        optical_length: passed on the way `(ray,)` [m]; for flights that left the volume, that of the whole chord.
    """

    collided: Tensor
    position: Tensor
    optical_length: Tensor


def fly(grid: DensityGrid, position: Tensor, direction: Tensor, optical_length: Tensor, step: float) -> Flight:
    """Follow rays until they have passed a given optical length.

    Within a step the density is linear, so the optical length is a quadratic, solved exactly for the end point.

    Args:
        grid: the volume.
        position: starts `(ray, 3)` [m].
        direction: unit directions `(ray, 3)`.
        optical_length: to use up `(ray,)` [m], not negative; infinity to measure the whole chord.
        step: longest step in voxels.

    Returns:
        The flights.
    """
    near, far = grid.intersect(position, direction)
    stride = step * float(grid.voxel_size.min())
    steps = torch.ceil((far - near) / stride).clamp_(min=1.0)
    length = (far - near) / steps
    origin = grid.voxel_coordinates(position + near[:, None] * direction)
    rate = direction / grid.voxel_size * length[:, None]
    if fused_loops_wanted(grid.density, position, direction, optical_length):
        from render.fused_flight import march_flights  # needs numba

        table, target = grid.table, optical_length.expand_as(length)
        collided, travelled, passed = march_flights(table.padded, table.clearance, origin, rate, length, steps, target)
    else:
        collided, travelled, passed = _march_lanes(grid, origin, rate, length, steps, optical_length)
    return Flight(collided, position + (near + travelled)[:, None] * direction, passed)


def _march_lanes(
    grid: DensityGrid, origin: Tensor, rate: Tensor, length: Tensor, steps: Tensor, optical_length: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Which flights ended inside, the distance from the box's face until then, and the optical length passed."""
    lanes = _Lanes.depart(grid, origin, rate, length, steps, optical_length)
    collided = torch.zeros(len(length), dtype=torch.bool, device=length.device)
    travelled, passed = torch.zeros_like(length), torch.zeros_like(length)
    first = 0
    while len(lanes.index):
        block = _march_block(grid, lanes, first)
        collided[block.hit] = True
        travelled[block.hit] = block.distance
        passed[block.left] = block.passed
        lanes = block.lanes
        first += BLOCK
    return collided, travelled, torch.where(collided, optical_length, passed)


def march_to_sun(
    grid: DensityGrid, position: Tensor, sun_direction: Tensor, smallest_extinction: Tensor, step: float
) -> Tensor:
    """Optical length from points to the sun, measured no further than light reaches.

    Args:
        grid: the volume.
        position: points `(point, 3)` [m].
        sun_direction: unit vector towards the sun `(3,)`.
        smallest_extinction: the lengths will be multiplied with, a scalar [1/m].
        step: longest step in voxels.

    Returns:
        Optical lengths `(point,)` [m], at most DARKEST_DEPTH over the smallest extinction.
    """
    farthest = (DARKEST_DEPTH / smallest_extinction).expand(len(position))
    return fly(grid, position, sun_direction.expand_as(position), farthest, step).optical_length


@dataclass(frozen=True, eq=False)
class _Lanes:
    """Flights that are still under way; coordinates in voxels, one row an axis."""

    index: Tensor
    origin: Tensor
    rate: Tensor
    length: Tensor
    steps: Tensor
    passed: Tensor
    target: Tensor
    density: Tensor

    @classmethod
    def depart(
        cls, grid: DensityGrid, origin: Tensor, rate: Tensor, length: Tensor, steps: Tensor, optical_length: Tensor
    ) -> "_Lanes":
        """Flights that enter the volume, at their first sample."""
        index = torch.nonzero(length > 0).flatten()
        origin, rate = origin[index].T.contiguous(), rate[index].T.contiguous()
        density = grid.table.look_up(*origin)
        passed = torch.zeros_like(length[index])
        return cls(index, origin, rate, length[index], steps[index], passed, optical_length[index], density)

    def keep(self, rows: Tensor, passed: Tensor, density: Tensor) -> "_Lanes":
        """The flights of some rows, with the optical length they have passed and the density where they are."""
        return _Lanes(
            self.index[rows],
            self.origin[:, rows],
            self.rate[:, rows],
            self.length[rows],
            self.steps[rows],
            passed[rows],
            self.target[rows],
            density[rows],
        )


@dataclass(frozen=True, eq=False)
class _Block:
    """Outcome of one block: flights that ended inside and their distances, flights that left, and those under way."""

    hit: Tensor
    distance: Tensor
    left: Tensor
    passed: Tensor
    lanes: _Lanes


def _march_block(grid: DensityGrid, lanes: _Lanes, first: int) -> _Block:
    """March up to BLOCK steps."""
    number = torch.arange(first + 1, first + BLOCK + 1, dtype=torch.float32, device=lanes.length.device)
    x, y, z = (lanes.origin[axis, :, None] + lanes.rate[axis, :, None] * number for axis in range(3))
    density = torch.cat([lanes.density[:, None], grid.table.look_up(x, y, z)], dim=1)
    increments = 0.5 * lanes.length[:, None] * (density[:, :-1] + density[:, 1:])
    increments = torch.where(number <= lanes.steps[:, None], increments, 0.0)
    cumulative = lanes.passed[:, None] + increments.cumsum(1)
    crossed = cumulative > lanes.target[:, None]
    hit = crossed[:, -1]
    rows = torch.nonzero(hit).flatten()
    cell = crossed[rows].int().argmax(1)
    missing = lanes.target[rows] - (cumulative[rows, cell] - increments[rows, cell])
    fraction = _solve_step(density[rows, cell], density[rows, cell + 1], missing / lanes.length[rows])
    under_way = ~hit & (lanes.steps > first + BLOCK)
    left = ~hit & ~under_way
    return _Block(
        hit=lanes.index[rows],
        distance=(first + cell + fraction) * lanes.length[rows],
        left=lanes.index[left],
        passed=cumulative[left, -1],
        lanes=lanes.keep(torch.nonzero(under_way).flatten(), cumulative[:, -1], density[:, -1]),
    )


def _solve_step(density_start: Tensor, density_end: Tensor, amount: Tensor) -> Tensor:
    """Fraction f of a step with  f d0 + f^2 (d1 - d0)/2 = amount, in the form that does not cancel for d1 near d0."""
    slope = density_end - density_start
    root = (density_start * density_start + 2.0 * slope * amount).clamp(min=0.0).sqrt()
    return (2.0 * amount / (density_start + root).clamp(min=1e-30)).clamp(0.0, 1.0)
