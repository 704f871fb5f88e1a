"""Free flights from every point of a lattice along fixed directions, one each, for all extinctions of a group at once."""

from dataclasses import dataclass

import torch
from torch import Tensor

from precompute.direction_sets import DirectionSet
from precompute.gather import Lattice
from precompute.light_lattice import LightLattice
from render.density_grid import DensityGrid
from render.free_flight import fly
from render.fused import fused_loops_wanted

BITS, FRACTIONS = 5, (1 << 5) - 1
"""Of a place within a cell along each axis, and the largest number that they hold. Places are drawn: what rounding moves one by, it moves
another back."""

STEPS = (0.7548776662466927, 0.5698402909980532)
"""Of the flights' quantiles from direction to direction: a lattice in two dimensions (Roberts 2018, "The unreasonable effectiveness
of quasirandom sequences")."""

SMALLEST_QUANTILE = 2.0**-30
"""Of a flight: the longest one has an optical depth of 21."""

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


def locate_ends(lattice: Lattice, cell: Tensor, fraction: Tensor) -> Tensor:
    """Positions `(..., 3)` [m] of places in cells, as `DrawnFlights` has them."""
    nx, ny, _ = lattice.counts
    low = torch.stack([cell % nx, cell // nx % ny, cell // (nx * ny)], dim=-1)
    within = torch.stack([fraction >> shift & FRACTIONS for shift in (0, BITS, 2 * BITS)], dim=-1)
    return lattice.corner + (low + within / FRACTIONS) * lattice.spacing


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
    quantile = directions.place.double() @ torch.tensor(STEPS, dtype=torch.float64)
    draw = _draw_fused if fused_loops_wanted(grid.density, shift) else _draw
    cell, fraction = draw(grid, lattice, directions.direction, quantile, extinction.double(), shift.double(), step)
    flights = []
    for ends, within in zip(cell, fraction, strict=True):
        some, places = ends[::SPREAD_EVERY], within[::SPREAD_EVERY]
        inside = (one >= 0 for one in some)
        parts = (
            locate_ends(lattice.lattice, one[kept], place[kept])
            for one, place, kept in zip(some, places, inside, strict=True)
        )
        flights.append(DrawnFlights(ends, within, lattice.measure_spread(parts)))
    return flights


def _draw(
    grid: DensityGrid,
    lattice: LightLattice,
    directions: Tensor,
    quantile: Tensor,
    extinction: Tensor,
    shift: Tensor,
    step: float,
) -> tuple[Tensor, Tensor]:
    """Cells and fractions `(extinction, direction, point)`, as `DrawnFlights` has them."""
    shape = (len(extinction), len(directions), len(shift))
    cell, fraction = torch.full(shape, -1, dtype=torch.int32), torch.zeros(shape, dtype=torch.int16)
    for number, direction in enumerate(directions):
        moved = (shift + quantile[number]) % 1.0
        depth = -torch.log1p(-moved.clamp(SMALLEST_QUANTILE, 1.0 - SMALLEST_QUANTILE))
        rows, position, passed = torch.arange(len(shift)), lattice.positions, torch.zeros_like(depth)
        for node in range(len(extinction) - 1, -1, -1):
            length = depth / extinction[node]
            along = direction.expand_as(position).contiguous()
            flight = fly(grid, position, along, (length - passed).float(), step)
            inside = torch.nonzero(flight.collided).flatten()
            rows, position = rows[inside], flight.position[inside]
            depth, passed = depth[inside], length[inside]
            cell[node, number, rows], fraction[node, number, rows] = _place(lattice.lattice, position)
    return cell, fraction


def _draw_fused(
    grid: DensityGrid,
    lattice: LightLattice,
    directions: Tensor,
    quantile: Tensor,
    extinction: Tensor,
    shift: Tensor,
    step: float,
) -> tuple[Tensor, Tensor]:
    """The same in one fused loop."""
    from precompute.fused_drawn_flights import draw_flight_ends  # needs numba

    shape, box = (len(extinction), len(directions), len(shift)), lattice.lattice
    cell, fraction = torch.full(shape, -1, dtype=torch.int32), torch.zeros(shape, dtype=torch.int16)
    draw_flight_ends(
        grid.table.padded,
        grid.table.clearance,
        torch.stack([grid.lower, grid.upper, grid.voxel_size]),
        step * float(grid.voxel_size.min()),
        box.corner,
        box.spacing,
        torch.tensor(box.counts, dtype=torch.int32),
        lattice.positions,
        shift,
        directions,
        quantile,
        extinction,
        cell,
        fraction,
    )
    return cell, fraction


def _place(lattice: Lattice, position: Tensor) -> tuple[Tensor, Tensor]:
    """Cells of positions `(position, 3)` [m] and places within them, as `DrawnFlights` has them."""
    counts = torch.tensor(lattice.counts)
    place = (position - lattice.corner) / lattice.spacing
    cell = place.int().clamp(min=0).minimum((counts - 2).clamp(min=0).int())
    within = ((place - cell).clamp(0.0, 1.0) * FRACTIONS).round().short()
    low = cell[:, 0] + int(counts[0]) * (cell[:, 1] + int(counts[1]) * cell[:, 2])
    return low.int(), within[:, 0] + (within[:, 1] << BITS) + (within[:, 2] << 2 * BITS)
