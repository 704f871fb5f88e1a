"""Flights that all extinctions share end where a flight of each alone would."""

import pytest
import torch

from precompute.direction_sets import turned_directions
from precompute.drawn_flights import BITS, FRACTIONS, STEPS, DrawnFlights, draw_flights, locate_ends
from precompute.light_lattice import LightLattice, light_lattice_over
from render.density_grid import DensityGrid
from render.free_flight import fly
from tests.support.volumes import noise_box, uniform_box

pytestmark = pytest.mark.usefixtures("loops")

DIRECTIONS = turned_directions(1, torch.tensor([0.2, 0.5, 0.9]))
EXTINCTION, STEP = torch.tensor([0.05, 0.3, 2.0]), 0.1


def flights(grid: DensityGrid, extinction: torch.Tensor = EXTINCTION) -> tuple[LightLattice, list[DrawnFlights]]:
    lattice = light_lattice_over(grid, 1.0, 4000)
    shift = torch.rand(len(lattice.numbers), generator=torch.Generator().manual_seed(1))
    return lattice, draw_flights(grid, lattice, DIRECTIONS, extinction, shift, STEP)


def ends(lattice: LightLattice, drawn: DrawnFlights, number: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Points whose flights along a direction ended inside, and where."""
    inside = torch.nonzero(drawn.cell[number] >= 0).flatten()
    return inside, locate_ends(lattice.lattice, drawn.cell[number, inside], drawn.fraction[number, inside])


@pytest.mark.parametrize("grid", [noise_box(), noise_box(9, sparse=0.8)])
def test_each_extinction_ends_where_its_own_flight_would(grid: DensityGrid) -> None:
    lattice, drawn = flights(grid)
    shift = torch.rand(len(lattice.numbers), generator=torch.Generator().manual_seed(1)).double()
    outermost = lattice.lattice.positions(torch.tensor([0, lattice.lattice.size - 1]))
    for number, direction in enumerate(DIRECTIONS.direction):
        moved = shift + float(DIRECTIONS.place[number].double() @ torch.tensor(STEPS, dtype=torch.float64))
        depth = -torch.log1p(-(moved % 1.0))
        for extinction, one in zip(EXTINCTION.tolist(), drawn, strict=True):
            along = direction.expand(len(shift), 3).contiguous()
            alone = fly(grid, lattice.positions, along, (depth / extinction).float(), STEP)
            inside, found = ends(lattice, one, number)
            # Steps that begin elsewhere see a slightly different density between them.
            assert int((~alone.collided[inside]).sum()) <= 0.02 * len(shift)
            assert abs(len(inside) - int(alone.collided.sum())) <= 0.02 * len(shift)
            inside, found = inside[alone.collided[inside]], found[alone.collided[inside]]
            held = alone.position[inside].clamp(outermost[0], outermost[1])
            assert float((found - held).norm(dim=1).quantile(0.9)) < 0.03


def test_a_thinner_cloud_s_flights_are_longer_or_leave() -> None:
    lattice, drawn = flights(uniform_box((6.0, 6.0, 6.0), (12, 12, 12)))
    left = [float((one.cell < 0).float().mean()) for one in drawn]
    assert left[0] > left[1] > left[2] > 0.0
    for number in range(len(DIRECTIONS.direction)):
        thick, thin = (ends(lattice, one, number) for one in (drawn[2], drawn[1]))
        both = torch.isin(thick[0], thin[0])
        assert torch.equal(thick[0][both], thin[0])
        starts = lattice.positions[thin[0]]
        near, far = ((places - starts).norm(dim=1) for places in (thick[1][both], thin[1]))
        assert float((far - near).min()) > -0.01


def test_one_extinction_s_flights_do_not_depend_on_thinner_ones() -> None:
    thick, all_ = flights(noise_box(), EXTINCTION[2:])[1][0], flights(noise_box())[1][2]
    assert torch.equal(thick.cell, all_.cell)
    assert torch.equal(thick.fraction, all_.fraction)
    torch.testing.assert_close(thick.spread, all_.spread)
    assert float(thick.spread.max()) <= 0.125


def test_ends_are_where_their_cells_and_fractions_say() -> None:
    lattice = light_lattice_over(uniform_box((6.0, 6.0, 6.0), (4, 6, 12)), 1.0, 4000).lattice
    nx, ny, _ = lattice.counts
    cell = torch.tensor([0, 2 + nx * (1 + ny * 3)], dtype=torch.int32)
    fraction = torch.tensor([FRACTIONS << BITS, FRACTIONS + (FRACTIONS << 2 * BITS)], dtype=torch.int16)
    expected = lattice.corner + torch.tensor([[0.0, 1.0, 0.0], [3.0, 1.0, 4.0]]) * lattice.spacing
    torch.testing.assert_close(locate_ends(lattice, cell, fraction), expected)
