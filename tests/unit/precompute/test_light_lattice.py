"""The lattice holds every point that light is interpolated from, and interpolation on it spreads nothing."""

import math
from collections.abc import Callable

import pytest
import torch

from precompute.gather import lattice_over
from precompute.light_lattice import LightLattice, light_lattice_over, spacing_for
from render.density_grid import DensityGrid
from tests.support.volumes import noise_box, uniform_box


def one_filled_voxel() -> DensityGrid:
    density = torch.zeros(7, 6, 5)
    density[2, 4, 1] = 1.0
    return DensityGrid.from_voxel_size(density, (1.0, 2.0, 0.5))


GRIDS: dict[str, Callable[[], DensityGrid]] = {
    "noise": lambda: noise_box(9),
    "holes": lambda: noise_box(9, sparse=0.9),
    "one voxel": lambda: uniform_box(voxels=(1, 1, 1)),
    "one voxel thick": lambda: uniform_box(voxels=(5, 1, 7)),
    "one filled voxel": one_filled_voxel,
    "column": lambda: DensityGrid.from_voxel_size(torch.eye(9)[:, 3].reshape(9, 1, 1), (1.0, 2.0, 0.5)),
}


def places_in_cloud(grid: DensityGrid, count: int = 20_000) -> torch.Tensor:
    """Random places `(place, 3)` [m] with density."""
    share = torch.rand(count, 3, generator=torch.Generator().manual_seed(5))
    places = grid.lower + share * (grid.upper - grid.lower)
    return places[grid.look_up_density(places) > 0]


def whole_lattice(voxels: int = 8) -> LightLattice:
    return light_lattice_over(uniform_box((8.0, 8.0, 8.0), (voxels,) * 3), 1.0, voxels**3)


def missing_corners(grid: DensityGrid, lattice: LightLattice, numbers: torch.Tensor) -> int:
    """Corners of places in the cloud that are none of the numbered points."""
    corners, _ = lattice.lattice.corners(places_in_cloud(grid))
    return int((~torch.isin(corners.long(), numbers)).sum())


@pytest.mark.parametrize("shift", [-0.25, 0.0, 0.25])
@pytest.mark.parametrize("spacing", [1.0, 1.7, 3.0, 50.0])
@pytest.mark.parametrize("name", GRIDS)
def test_all_corners_around_density_are_points(name: str, spacing: float, shift: float) -> None:
    grid = GRIDS[name]()
    lattice = light_lattice_over(grid, spacing, 10_000, shift)
    assert len(places_in_cloud(grid))
    assert missing_corners(grid, lattice, lattice.numbers) == 0
    assert missing_corners(grid, lattice, lattice.numbers[1:]) > 0


def test_empty_regions_have_no_points() -> None:
    lattice = light_lattice_over(one_filled_voxel(), 1.0, 10_000)
    # The voxel reaches one voxel to either side, which cells of three points an axis hold, at most four by rounding.
    assert 27 <= len(lattice.numbers) <= 64
    assert lattice.lattice.size == 7 * 6 * 5
    assert len(light_lattice_over(DensityGrid.from_voxel_size(torch.zeros(4, 4, 4), 1.0), 1.0, 100).numbers) == 0


@pytest.mark.parametrize("points", [30, 100, 400])
@pytest.mark.parametrize("name", ["noise", "holes"])
def test_the_number_of_points_is_respected(name: str, points: int) -> None:
    grid = GRIDS[name]()
    unlimited = light_lattice_over(grid, 1.0, 10_000)
    assert len(unlimited.numbers) > 1.1 * points
    limited = light_lattice_over(grid, 1.0, points)
    assert 0.2 * points < len(limited.numbers) <= 1.1 * points


def test_spacing_is_as_wanted_where_points_allow_it() -> None:
    grid = noise_box(9)
    for spacing in (1.0, 1.5, 3.0):
        expected = lattice_over(grid, spacing).spacing
        torch.testing.assert_close(light_lattice_over(grid, spacing, 10_000).lattice.spacing, expected)
    torch.testing.assert_close(light_lattice_over(grid, 0.2, 10_000).lattice.spacing, grid.voxel_size)


def test_points_numbers_and_entries_belong_together() -> None:
    lattice = light_lattice_over(noise_box(9, sparse=0.9), 1.0, 10_000)
    count = len(lattice.numbers)
    assert count < lattice.lattice.size
    assert lattice.entry.dtype == torch.int32
    assert torch.equal(lattice.entry[lattice.numbers].long(), torch.arange(count))
    others = torch.ones(lattice.lattice.size, dtype=torch.bool)
    others[lattice.numbers] = False
    assert not lattice.entry[others].any()
    torch.testing.assert_close(lattice.positions, lattice.lattice.positions(lattice.numbers))


@pytest.mark.parametrize("name", GRIDS)
def test_neighbours_lie_one_spacing_away_on_both_sides_or_are_the_point_itself(name: str) -> None:
    lattice = light_lattice_over(GRIDS[name](), 1.0, 10_000)
    offset = (lattice.positions[lattice.neighbours] - lattice.positions[:, None]) / lattice.lattice.spacing
    offset = offset.round().reshape(-1, 3, 2, 3)
    own = torch.arange(len(lattice.numbers))[:, None, None].expand(-1, 3, 2)
    alone = lattice.neighbours.reshape(-1, 3, 2) == own
    assert torch.equal(alone[..., 0], alone[..., 1])
    for axis in range(3):
        for side, sign in ((0, -1.0), (1, 1.0)):
            step = sign * torch.eye(3)[axis]
            assert torch.equal(offset[:, axis, side], torch.where(alone[:, axis, side, None], 0.0, step))
    counts = torch.tensor(lattice.lattice.counts)
    place = ((lattice.positions - lattice.lattice.corner) / lattice.lattice.spacing).round()
    at_edge = (place == 0) | (place == counts - 1)
    assert alone[..., 0][at_edge].all()
    if name == "noise":
        assert not alone[..., 0][~at_edge].any()


def quadratic(places: torch.Tensor) -> torch.Tensor:
    x, y, z = places.double().unbind(-1)
    return 1.0 + 0.3 * x - 0.2 * z + 0.5 * x * x + 0.1 * y * y - 0.3 * z * z + 0.2 * x * y


def test_sharpened_values_keep_the_mean_of_a_quadratic() -> None:
    lattice = whole_lattice()
    # Midpoints of 8^3 parts of the inner cell from 0.5 to 1.5 m; their w (1 - w) averages 1/6 less 1/12 of a part squared.
    fine = (torch.arange(8) + 0.5) / 8.0 + 0.5
    places = torch.cartesian_prod(fine, fine, fine)
    share = (places - 0.5) % 1.0
    spread = torch.full((len(lattice.numbers),), float(0.5 * (share * (1.0 - share)).mean()))
    values = quadratic(lattice.positions).float()[:, None]
    exact = float(quadratic(places).mean())
    sharp = float(lattice.interpolate(lattice.sharpen(values, spread), places).double().mean())
    plain = float(lattice.interpolate(values, places).double().mean())
    assert sharp == pytest.approx(exact, abs=1e-6)
    assert plain - exact == pytest.approx((0.5 + 0.1 - 0.3) / 6.0, rel=0.02)


def test_sharpening_leaves_linear_values_alone() -> None:
    lattice = whole_lattice()
    values = lattice.positions @ torch.tensor([[1.0, 0.5], [-2.0, 0.0], [0.3, 4.0]])
    spread = torch.linspace(0.0, 0.125, len(lattice.numbers))
    torch.testing.assert_close(lattice.sharpen(values, spread), values, atol=1e-5, rtol=0.0)
    assert not torch.allclose(lattice.sharpen(values**2, spread), values**2, atol=1e-2)


def test_interpolation_at_points_gives_their_values() -> None:
    lattice = light_lattice_over(noise_box(9, sparse=0.5), 1.5, 10_000)
    values = torch.rand(len(lattice.numbers), 3, generator=torch.Generator().manual_seed(6))
    torch.testing.assert_close(lattice.interpolate(values, lattice.positions), values, atol=1e-5, rtol=0.0)
    moved = lattice.positions + 0.5 * lattice.lattice.spacing
    assert not torch.allclose(lattice.interpolate(values, moved), values, atol=0.1)


def test_the_spread_is_measured() -> None:
    lattice = whole_lattice()
    inner = (lattice.positions.abs().amax(1) < 3.0).nonzero().flatten()
    share = torch.rand(200_000, 3, generator=torch.Generator().manual_seed(7))
    random = lattice.measure_spread([8.0 * part - 4.0 for part in share.split(50_000)])
    # About 390 places a cell, each with three shares; w (1 - w) varies by 0.0745, half of it by 0.037.
    assert float((random[inner] - 1.0 / 12.0).abs().max()) < 5.0 * 0.0373 / math.sqrt(390.0)
    assert float(random[inner].mean()) == pytest.approx(1.0 / 12.0, rel=3e-3)
    assert float(lattice.measure_spread([lattice.positions]).abs().max()) < 1e-5
    middles = lattice.positions[inner] + 0.5
    assert float(lattice.measure_spread([middles])[inner].max()) == pytest.approx(0.125, rel=1e-5)
    along_x = lattice.positions[inner] + torch.tensor([0.5, 0.0, 0.0])
    assert float(lattice.measure_spread([along_x])[inner].max()) == pytest.approx(0.125 / 3.0, rel=1e-4)


def test_spread_without_places_is_none() -> None:
    assert not whole_lattice().measure_spread([torch.empty(0, 3)]).any()


def test_spacing_follows_from_the_densest_voxel() -> None:
    grid = DensityGrid.from_voxel_size(torch.tensor([0.5, 2.0]).reshape(2, 1, 1), (1.0, 3.0, 0.25))
    # The densest voxel has an optical depth of 0.1 * 2 * 0.25 along its shortest edge.
    assert spacing_for(grid, 0.1, 1.0) == pytest.approx(20.0)
    assert spacing_for(grid, 0.2, 1.0) == pytest.approx(10.0)
    assert spacing_for(DensityGrid.from_voxel_size(torch.zeros(2, 2, 2), 1.0), 0.1, 1.0) == math.inf
