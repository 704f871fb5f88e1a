"""Free flights from every point of a lattice along fixed directions, one each, for all extinctions of a group at once."""

from dataclasses import dataclass

import torch
from torch import Tensor

from precompute.direction_sets import DirectionSet
from precompute.free_flight import fly
from precompute.light_lattice import LightLattice
from render.density_grid import DensityGrid

BITS, FRACTIONS = 5, (1 << 5) - 1
"""Of a place within a cell along each axis, and the largest number that they hold. Places are drawn: what rounding moves one by, it moves
another back."""

STEPS = (0.7548776662466927, 0.5698402909980532)
"""Of the flights' quantiles from direction to direction: a lattice in two dimensions (Roberts 2018, "The unreasonable effectiveness
of quasirandom sequences")."""

SPREAD_EVERY = 4
"""One direction in so many tells the mean spread of interpolation."""


@dataclass(frozen=True, eq=False)
class DrawnFlights:
    """Where flights from each point end at one extinction.

    Args:
        cell: lattice point at the low corner of that place `(direction, point)` int32; -1 where the flight left the volume.
        fraction: along x, y and z within the cell, in `BITS` each `(direction, point)` int16.
        spread: of interpolation around each point, see `LightLattice.sharpen` `(point,)`.
    """

    cell: Tensor
    fraction: Tensor
    spread: Tensor

    def part(self, directions: slice) -> "DrawnFlights":
        """The flights along some directions."""
        return DrawnFlights(self.cell[directions], self.fraction[directions], self.spread)


def draw_flights(
    grid: DensityGrid, lattice: LightLattice, directions: DirectionSet, extinction: Tensor, shift: Tensor, step: float
) -> list[DrawnFlights]:
    """Flights for each extinction, which share their quantiles: a thinner cloud's go on where a thicker one's end.

    Args:
        grid: the volume.
        lattice: whose points they start from.
        directions: to fly along.
        extinction: rising `(extinction,)` [1/m].
        shift: of the quantiles of each point, in 0..1 `(point,)`.
        step: longest marching step in voxels.
    """
    shape = (len(extinction), len(directions.direction), len(shift))
    cell, fraction = torch.full(shape, -1, dtype=torch.int32), torch.zeros(shape, dtype=torch.int16)
    ends: list[list[Tensor]] = [[] for _ in extinction]
    quantile = directions.place.double() @ torch.tensor(STEPS, dtype=torch.float64)
    for number, direction in enumerate(directions.direction):
        moved = shift.double() + float(quantile[number])
        depth = -torch.log1p(-(moved % 1.0).clamp(2.0**-30, 1.0 - 2.0**-30))
        rows, position, passed = torch.arange(len(shift)), lattice.positions, torch.zeros_like(depth)
        for node in range(len(extinction) - 1, -1, -1):
            length = depth / float(extinction[node])
            along = direction.expand_as(position).contiguous()
            flight = fly(grid, position, along, (length - passed).float(), step)
            inside = torch.nonzero(flight.collided).flatten()
            rows, position = rows[inside], flight.position[inside]
            depth, passed = depth[inside], length[inside]
            cell[node, number, rows], fraction[node, number, rows] = _place(lattice, position)
            if number % SPREAD_EVERY == 0:
                ends[node].append(position)
    spread = [lattice.measure_spread(of_node) for of_node in ends]
    return [DrawnFlights(*one) for one in zip(cell, fraction, spread, strict=True)]


def _place(lattice: LightLattice, position: Tensor) -> tuple[Tensor, Tensor]:
    """Cells of positions `(position, 3)` [m] and places within them, as `DrawnFlights` has them."""
    counts = torch.tensor(lattice.lattice.counts)
    place = (position - lattice.lattice.corner) / lattice.lattice.spacing
    cell = place.int().clamp(min=0).minimum((counts - 2).clamp(min=0).int())
    within = ((place - cell).clamp(0.0, 1.0) * FRACTIONS).round().short()
    low = cell[:, 0] + int(counts[0]) * (cell[:, 1] + int(counts[1]) * cell[:, 2])
    return low.int(), within[:, 0] + (within[:, 1] << BITS) + (within[:, 2] << 2 * BITS)
