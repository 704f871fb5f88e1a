"""The fused flights from lattice points end where those of torch do, whatever the volume, the step or the chunks."""

from collections.abc import Callable

import pytest
import torch

pytest.importorskip("numba")

from precompute import fused_drawn_flights
from precompute.direction_sets import turned_directions
from precompute.drawn_flights import FRACTIONS, DrawnFlights, draw_flights, locate_ends
from precompute.light_lattice import LightLattice, light_lattice_over
from render.density_grid import DensityGrid
from render.fused import fused_loops_wanted, torch_loops_only
from tests.support.volumes import noise_box, uniform_box

pytestmark = pytest.mark.skipif(not fused_loops_wanted(), reason="the fused loops are turned off")

GRIDS: dict[str, Callable[[], DensityGrid]] = {
    "noise": noise_box,
    "holes": lambda: noise_box(8, sparse=0.7),
    "one voxel": lambda: uniform_box(voxels=(1, 1, 1)),
    "one voxel thick": lambda: uniform_box(voxels=(5, 1, 7)),
    "one column": lambda: DensityGrid.from_voxel_size(torch.linspace(0.2, 1.0, 9).reshape(9, 1, 1), (1.0, 2.0, 0.5)),
    "thick": lambda: DensityGrid.from_voxel_size(500.0 * noise_box().density, 1.0),
}
EXTINCTION = torch.tensor([0.05, 0.3, 2.0])


def drawn(grid: DensityGrid, step: float) -> tuple[LightLattice, list[DrawnFlights]]:
    lattice = light_lattice_over(grid, 1.0, 2000, 0.25)
    shift = torch.rand(len(lattice.numbers), generator=torch.Generator().manual_seed(1))
    directions = turned_directions(2, torch.tensor([0.2, 0.5, 0.9]))
    return lattice, draw_flights(grid, lattice, directions, EXTINCTION, shift, step)


@pytest.mark.parametrize("step", [0.25, 1.0])
@pytest.mark.parametrize("name", GRIDS)
def test_flights_end_where_those_of_torch_do(name: str, step: float) -> None:
    grid = GRIDS[name]()
    lattice, fused = drawn(grid, step)
    with torch_loops_only():
        _, plain = drawn(grid, step)
    for one, other in zip(fused, plain, strict=True):
        left, stayed = (one.cell < 0) & (other.cell < 0), (one.cell >= 0) & (other.cell >= 0)
        # A flight that ends just where the volume does may fall on either side by rounding.
        assert float((left | stayed).float().mean()) > 0.998
        ends = [
            locate_ends(lattice.lattice, flights.cell[stayed], flights.fraction[stayed]) for flights in (one, other)
        ]
        # So may a place between two fractions of a cell.
        apart = (ends[0] - ends[1]).abs() / lattice.lattice.spacing
        assert float(apart.max() if len(apart) else 0.0) <= 1.001 / FRACTIONS
        assert float((apart > 1e-3).float().mean() if len(apart) else 0.0) < 0.01
        torch.testing.assert_close(one.spread, other.spread, rtol=0.01, atol=1e-3)
    assert 0.02 < float(torch.stack([one.cell >= 0 for one in fused]).float().mean()) < 0.999


def test_chunks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    grid = GRIDS["holes"]()
    _, usual = drawn(grid, 0.5)
    monkeypatch.setattr(fused_drawn_flights, "CHUNK", 7)
    _, other = drawn(grid, 0.5)
    for one, two in zip(usual, other, strict=True):
        assert torch.equal(one.cell, two.cell)
        assert torch.equal(one.fraction, two.fraction)
