"""The fused loops of carried light give the sums of the torch loops."""

import pytest
import torch

pytest.importorskip("numba")

from precompute import fused_gather
from precompute.carried_orders import _gather, _sharpen
from precompute.drawn_flights import BITS, FRACTIONS, DrawnFlights
from precompute.fused_gather import gather_flights, sharpen_light
from precompute.light_lattice import LightLattice, light_lattice_over
from render.density_grid import DensityGrid
from render.fused import fused_loops_wanted
from tests.support.volumes import noise_box, uniform_box

pytestmark = pytest.mark.skipif(not fused_loops_wanted(), reason="the fused loops are turned off")

GRIDS = {
    "noise": lambda: noise_box(7),
    "holes": lambda: noise_box(11, sparse=0.9),
    "one voxel": lambda: uniform_box(voxels=(1, 1, 1)),
    "one voxel thick": lambda: uniform_box(voxels=(5, 1, 7)),
    "one column": lambda: DensityGrid.from_voxel_size(torch.ones(9, 1, 1), (1.0, 2.0, 0.5)),
}
HARMONICS, COLUMNS, DIRECTIONS = 3, 2, 5


def lattice_of(name: str) -> LightLattice:
    return light_lattice_over(GRIDS[name](), 1.0, 10_000)


def whole_cells(lattice: LightLattice) -> torch.Tensor:
    """Low corners of the cells whose corners are all points, as those are where a flight can end."""
    counts = lattice.lattice.counts
    place = torch.cartesian_prod(*(torch.arange(max(n - 1, 1)) for n in counts)).float()
    corners, _ = lattice.lattice.corners(lattice.lattice.corner + (place + 0.5) * lattice.lattice.spacing)
    return corners[torch.isin(corners, lattice.numbers).all(1)][:, 0]


def random_flights(lattice: LightLattice, seed: int = 8) -> DrawnFlights:
    """Ends of flights in any cell with density, and some that left."""
    generator = torch.Generator().manual_seed(seed)
    shape, cells = (DIRECTIONS, len(lattice.numbers)), whole_cells(lattice)
    cell = cells[torch.randint(0, len(cells), shape, generator=generator)]
    cell = torch.where(torch.rand(shape, generator=generator) < 0.2, -1, cell)
    within = torch.randint(0, FRACTIONS + 1, (*shape, 3), generator=generator)
    # The ends of a cell, too.
    within = torch.where(torch.rand(within.shape, generator=generator) < 0.1, FRACTIONS, within)
    fraction = within[..., 0] + (within[..., 1] << BITS) + (within[..., 2] << 2 * BITS)
    return DrawnFlights(cell.int(), fraction.short(), 0.125 * torch.rand(shape[1], generator=generator))


def random_light(lattice: LightLattice, first: int) -> torch.Tensor:
    return torch.rand(first, len(lattice.numbers), COLUMNS, generator=torch.Generator().manual_seed(9))


def gather_both(name: str, scale: float = 1.0) -> tuple[torch.Tensor, torch.Tensor]:
    """What flights bring in torch and fused, the latter of values times a scale."""
    lattice = lattice_of(name)
    flights, along = random_flights(lattice), random_light(lattice, DIRECTIONS)
    plain, fused = torch.full_like(along, torch.nan), torch.full_like(along, torch.nan)
    _gather(lattice, along, flights, plain)
    counts = torch.tensor(lattice.lattice.counts)
    gather_flights(scale * along, lattice.entry, counts, flights.cell, flights.fraction, fused)
    return plain, fused


@pytest.mark.parametrize("chunk", [1, 7, 1 << 12])
@pytest.mark.parametrize("name", GRIDS)
def test_sharpening_is_that_of_torch(name: str, chunk: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fused_gather, "CHUNK", chunk)
    lattice = lattice_of(name)
    light, spread = random_light(lattice, HARMONICS), random_flights(lattice).spread
    plain, fused, other = (torch.full_like(light, torch.nan) for _ in range(3))
    _sharpen(lattice, light, spread, plain)
    sharpen_light(light, lattice.neighbours, spread, fused)
    torch.testing.assert_close(fused, plain, rtol=1e-6, atol=1e-6)
    sharpen_light(light, lattice.neighbours.flip(0), spread, other)
    assert len(lattice.numbers) == 1 or not torch.allclose(other, plain, rtol=1e-3)


@pytest.mark.parametrize("name", GRIDS)
def test_flights_bring_what_they_bring_in_torch(name: str) -> None:
    plain, fused = gather_both(name)
    torch.testing.assert_close(fused, plain, rtol=1e-6, atol=2e-6)
    assert float(plain.max()) > 0.1
    assert not torch.allclose(gather_both(name, 1.001)[1], plain, rtol=1e-6, atol=2e-6)


def test_flights_that_left_bring_nothing() -> None:
    lattice = lattice_of("noise")
    flights = random_flights(lattice)
    for brought in gather_both("noise"):
        assert not brought[flights.cell < 0].any()
        assert (brought[flights.cell >= 0] > 0.0).all()


def test_chunks_and_threads_are_no_part_of_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = gather_both("noise")[1]
    before = torch.get_num_threads()
    monkeypatch.setattr(fused_gather, "CHUNK", 13)
    torch.set_num_threads(2)
    try:
        found = gather_both("noise")[1]
    finally:
        torch.set_num_threads(before)
    assert torch.equal(found, expected)


def test_a_flight_to_a_point_brings_its_value() -> None:
    lattice = lattice_of("noise")
    along = random_light(lattice, 1)
    nx, ny, _ = lattice.lattice.counts
    cell = torch.full((1, len(lattice.numbers)), 1 + nx * (2 + ny * 3), dtype=torch.int32)
    counts, brought = torch.tensor(lattice.lattice.counts), torch.empty_like(along)
    # All 1023 of the ten bits along an axis is the far corner there.
    for fraction, corner in ((0, 0), (FRACTIONS, 1), (FRACTIONS << BITS, nx), (FRACTIONS << 2 * BITS, nx * ny)):
        fractions = torch.full_like(cell, fraction).short()
        gather_flights(along, lattice.entry, counts, cell, fractions, brought)
        expected = along[0, lattice.entry[int(cell[0, 0]) + corner].long()]
        torch.testing.assert_close(brought[0, 0], expected)
        assert not torch.allclose(brought[0, 0], along[0, lattice.entry[int(cell[0, 0]) + corner + 1].long()])
