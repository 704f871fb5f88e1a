"""Bags of source points: their weights are the opacity, and they integrate what a lattice can hold."""

import numpy as np
import pytest
import torch
from scipy import integrate

from precompute.gather import Bags, Lattice, gather_bags, lattice_over
from render.density_grid import DensityGrid
from render.ray_march import march_rays
from tests.support.rays import stratify_rays
from tests.support.volumes import noise_box, random_rays, uniform_box

EXTINCTION = torch.tensor([1e-6, 0.05, 0.4, 3.0, 2000.0])
NORTH_RAY = (torch.tensor([[0.3, -9.0, 0.4]]), torch.tensor([[0.0, 1.0, 0.0]]))


def all_bags(
    grid: DensityGrid, lattice: Lattice, rays: tuple[torch.Tensor, torch.Tensor], strata: int = 16
) -> list[Bags]:
    return list(gather_bags(lattice, *rays, stratify_rays(grid, *rays, EXTINCTION, strata)))


def integrate_source(bags: Bags, source: torch.Tensor) -> torch.Tensor:
    return (source[bags.numbers] * bags.weights).sum(1)


def test_a_lattice_fills_the_box() -> None:
    grid = uniform_box((4.0, 5.0, 6.0), (8, 10, 12))
    for stretch, counts in ((1.0, (8, 10, 12)), (2.0, (4, 5, 6)), (0.5, (16, 20, 24)), (100.0, (1, 1, 1))):
        lattice = lattice_over(grid, stretch)
        assert lattice.counts == counts
        assert lattice.size == counts[0] * counts[1] * counts[2]
        points = lattice.positions(torch.arange(lattice.size))
        torch.testing.assert_close(points.amin(0), grid.lower + 0.5 * lattice.spacing)
        torch.testing.assert_close(points.amax(0), grid.upper - 0.5 * lattice.spacing)


def test_numbers_run_along_x_first() -> None:
    lattice = Lattice(torch.tensor([1.0, 2.0, 3.0]), torch.tensor([0.1, 0.2, 0.3]), (3, 4, 5))
    found = lattice.positions(torch.tensor([0, 1, 3, 12, 59]))
    expected = [[1.0, 2.0, 3.0], [1.1, 2.0, 3.0], [1.0, 2.2, 3.0], [1.0, 2.0, 3.3], [1.2, 2.6, 4.2]]
    torch.testing.assert_close(found, torch.tensor(expected))


def random_points(lattice: Lattice, margin: float) -> torch.Tensor:
    """Points within the lattice and a margin around it, in spacings."""
    uniform = torch.rand(400, 3, generator=torch.Generator().manual_seed(0))
    return lattice.corner + lattice.spacing * (uniform * (torch.tensor(lattice.counts) - 1.0 + 2.0 * margin) - margin)


@pytest.mark.parametrize("counts", [(3, 4, 5), (1, 4, 5), (1, 1, 1), (2, 2, 2)])
def test_corners_reproduce_linear_functions_and_hold_the_border(counts: tuple[int, int, int]) -> None:
    lattice = Lattice(torch.tensor([1.0, 2.0, 3.0]), torch.tensor([0.5, 0.2, 0.3]), counts)
    slope = torch.tensor([2.0, -3.0, 0.5])
    values = lattice.positions(torch.arange(lattice.size)) @ slope
    for margin in (0.0, 2.0):
        points = random_points(lattice, margin)
        numbers, weights = lattice.corners(points)
        assert numbers.min() >= 0
        assert numbers.max() < lattice.size
        assert (weights >= 0.0).all()
        torch.testing.assert_close(weights.sum(-1), torch.ones(400))
        last = lattice.corner + lattice.spacing * (torch.tensor(counts) - 1)
        held = points.maximum(lattice.corner).minimum(last)
        torch.testing.assert_close((values[numbers] * weights).sum(-1), held @ slope, atol=1e-5, rtol=1e-5)
        if counts == (3, 4, 5):
            shifted = (held + 0.1) @ slope
            assert not torch.allclose((values[numbers] * weights).sum(-1), shifted, atol=1e-2)


def test_corners_of_many_points_keep_the_shape() -> None:
    lattice = Lattice(torch.zeros(3), torch.ones(3), (3, 4, 5))
    numbers, weights = lattice.corners(torch.rand(7, 6, 3))
    assert numbers.shape == weights.shape == (7, 6, 8)


@pytest.mark.parametrize("grid", [uniform_box(), noise_box(sparse=0.5), uniform_box(voxels=(1, 1, 1))])
def test_weights_sum_to_the_opacity(grid: DensityGrid) -> None:
    rays = random_rays(grid, 60)
    depth = march_rays(grid, *rays).total.double() * EXTINCTION.double()[:, None]
    for bags in all_bags(grid, lattice_over(grid, 1.0), rays):
        opacity = -torch.expm1(-depth[bags.extinction, bags.rays]).float()
        torch.testing.assert_close(bags.weights.sum(1), opacity, rtol=1e-5, atol=0.0)
        assert (bags.weights >= 0.0).all()
        torch.testing.assert_close(
            integrate_source(bags, torch.full((10_000,), 3.0)), 3.0 * opacity, rtol=1e-5, atol=0.0
        )


@pytest.mark.parametrize("strata", [16, 128])
def test_a_linear_source_is_integrated(strata: int) -> None:
    grid = uniform_box(voxels=(8, 10, 12))
    lattice = lattice_over(grid, 0.25)
    positions = lattice.positions(torch.arange(lattice.size))
    outermost = 2.5 - 0.5 * float(lattice.spacing[1])
    source = 1.0 + positions @ torch.tensor([0.2, 0.3, 0.4])
    for bags in all_bags(grid, lattice, NORTH_RAY, strata):
        s = float(EXTINCTION[bags.extinction])

        def integrand(depth: float, s: float = s) -> float:
            y = -2.5 + depth / s
            return (1.0 + 0.06 + 0.16 + 0.3 * np.clip(y, -outermost, outermost)) * np.exp(-depth)

        expected, _ = integrate.quad(integrand, 0.0, min(5.0 * s, 40.0), limit=200)
        found = float(integrate_source(bags, source))
        assert found == pytest.approx(expected, rel=5e-3 if strata == 16 else 6e-4)
        assert found != pytest.approx(expected * (1.0 + 0.3 * 0.5), rel=1e-2)


def test_a_thick_cloud_takes_what_the_camera_sees() -> None:
    grid = uniform_box(voxels=(8, 10, 12))
    lattice = lattice_over(grid, 1.0)
    distance = lattice.positions(torch.arange(lattice.size))[:, 1] + 2.5
    thin, *_, thick = (
        float(integrate_source(bags, distance) / bags.weights.sum()) for bags in all_bags(grid, lattice, NORTH_RAY)
    )
    assert thin == pytest.approx(2.5, rel=1e-3)
    assert thick == pytest.approx(0.25, rel=1e-3)  # the outermost points are half a spacing inside


def test_bags_cover_every_ray_and_extinction_once() -> None:
    grid = noise_box()
    rays = random_rays(grid, 30)
    seen = torch.zeros(30, len(EXTINCTION), dtype=torch.int32)
    for bags in all_bags(grid, lattice_over(grid, 1.0), rays):
        seen[bags.rays, bags.extinction] += 1
        assert bags.numbers.shape == bags.weights.shape == (30, 16 * 8)
    assert (seen == 1).all()


def test_light_is_where_density_is() -> None:
    density = torch.zeros(1, 30, 1)
    density[0, 20:25] = 1.0
    grid = DensityGrid(density, torch.tensor([-2.0, -2.5, -3.0]), torch.tensor([2.0, 2.5, 3.0]))
    lattice = lattice_over(grid, 1.0)
    y = lattice.positions(torch.arange(lattice.size))[:, 1]
    for bags in all_bags(grid, lattice, NORTH_RAY):
        used = bags.numbers[bags.weights > 0.0]
        assert float(y[used].min()) > -2.5 + 18.5 / 6.0
        assert float(y[used].max()) < -2.5 + 26.5 / 6.0
