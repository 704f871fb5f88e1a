"""The density in its box: where samples lie, what holds outside, and where rays enter and leave."""

import math
from dataclasses import FrozenInstanceError

import pytest
import torch

from render.density_grid import DensityGrid
from render.errors import VolumeError
from tests.support.volumes import noise_box, random_rays, uniform_box

LOWER, UPPER = torch.tensor([-1.0, 2.0, 3.0]), torch.tensor([4.0, 5.0, 10.0])


def linear_grid() -> DensityGrid:
    """Density 0.1 x + 0.2 y + 0.3 z of the world position at the voxel centres."""
    grid = DensityGrid(torch.zeros(7, 6, 5), LOWER, UPPER)
    z, y, x = torch.meshgrid(*(torch.arange(float(n)) for n in (7, 6, 5)), indexing="ij")
    centres = LOWER + (torch.stack([x, y, z], dim=-1) + 0.5) * grid.voxel_size
    return DensityGrid(centres @ torch.tensor([0.1, 0.2, 0.3]), LOWER, UPPER)


def test_linear_densities_are_exact_between_the_centres() -> None:
    grid = linear_grid()
    half = 0.5 * grid.voxel_size
    points = (
        LOWER + half + torch.rand(300, 3, generator=torch.Generator().manual_seed(0)) * (UPPER - LOWER - 2.0 * half)
    )
    expected = points @ torch.tensor([0.1, 0.2, 0.3])
    torch.testing.assert_close(grid.look_up_density(points), expected, rtol=1e-5, atol=1e-6)
    assert not torch.allclose(grid.look_up_density(points + half), expected, atol=1e-2)


def test_samples_lie_at_the_voxel_centres() -> None:
    grid = noise_box(3)
    for z in range(3):
        for y in range(3):
            for x in range(3):
                centre = grid.lower + torch.tensor([x + 0.5, y + 0.5, z + 0.5])
                assert float(grid.look_up_density(centre)) == pytest.approx(float(grid.density[z, y, x]), rel=1e-6)


def test_the_outer_half_voxel_is_held() -> None:
    grid = noise_box(3)
    z, y = -0.25, 0.75
    inner = grid.look_up_density(torch.tensor([-1.0, y, z]))
    torch.testing.assert_close(grid.look_up_density(torch.tensor([[-1.5, y, z], [-1.2, y, z]])), inner.expand(2))
    assert not torch.allclose(grid.look_up_density(torch.tensor([-0.8, y, z])), inner, atol=1e-3)


def test_outside_is_nothing() -> None:
    grid = uniform_box()
    face = float(grid.upper[0])
    inside = torch.tensor([[face, 0.0, 0.0], [face - 1e-3, 0.0, 0.0]])
    outside = torch.tensor([[face + 1e-3, 0.0, 0.0], [-face - 1e-3, 0.0, 0.0], [0.0, 99.0, 0.0], [0.0, 0.0, -99.0]])
    assert grid.look_up_density(inside).tolist() == [1.0, 1.0]
    assert grid.look_up_density(outside).tolist() == [0.0] * 4


def test_one_voxel_fills_its_box() -> None:
    grid = DensityGrid.from_voxel_size(torch.full((1, 1, 1), 2.5), 4.0)
    points = 2.0 * (2.0 * torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) - 1.0)
    assert torch.equal(grid.look_up_density(points), torch.full((50,), 2.5))
    assert float(grid.look_up_density(torch.tensor([2.1, 0.0, 0.0]))) == 0.0
    assert grid.radius == pytest.approx(2.0 * math.sqrt(3.0))


def test_boxes_from_voxel_sizes() -> None:
    grid = DensityGrid.from_voxel_size(torch.zeros(2, 3, 4), (1.0, 2.0, 3.0))
    assert grid.upper.tolist() == [2.0, 3.0, 3.0]
    assert grid.lower.tolist() == [-2.0, -3.0, -3.0]
    assert grid.centre.tolist() == [0.0, 0.0, 0.0]
    assert grid.voxel_size.tolist() == [1.0, 2.0, 3.0]
    placed = DensityGrid.from_voxel_size(torch.zeros(2, 3, 4), 0.5, lower=(10.0, 20.0, 30.0))
    assert placed.upper.tolist() == [12.0, 21.5, 31.0]


def test_visible_points_are_the_dense_voxels() -> None:
    density = torch.zeros(2, 3, 4)
    density[1, 2, 3], density[0, 1, 0], density[0, 0, 0] = 1.0, 0.02, 0.005
    grid = DensityGrid.from_voxel_size(density, 1.0, lower=(0.0, 0.0, 0.0))
    assert sorted(grid.visible_points.tolist()) == [[0.5, 1.5, 0.5], [3.5, 2.5, 1.5]]
    assert grid.maximum == 1.0
    assert len(DensityGrid.from_voxel_size(torch.zeros(2, 2, 2), 1.0).visible_points) == 0


@pytest.mark.parametrize(
    ("density", "complaint"),
    [
        (torch.full((2, 2, 2), torch.nan), "8 NaN"),
        (torch.tensor([[[1.0, torch.inf]]]), "1 NaN or infinite"),
        (torch.tensor([[[1.0, 1e300]]], dtype=torch.float64), "infinite"),
        (torch.tensor([[[1.0, -1e-6]]]), "-1e-06"),
        (torch.zeros(2, 2), r"\(2, 2\)"),
        (torch.zeros(2, 2, 2, 1), r"\(2, 2, 2, 1\)"),
        (torch.zeros(2, 0, 2), r"\(2, 0, 2\)"),
        (torch.tensor(1.0), r"\(\)"),
    ],
)
def test_what_is_no_density_is_refused(density: torch.Tensor, complaint: str) -> None:
    with pytest.raises(VolumeError, match=complaint):
        DensityGrid(density, LOWER, UPPER)
    with pytest.raises(VolumeError, match=complaint):
        DensityGrid.from_voxel_size(density, (1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("lower", "upper", "complaint"),
    [
        ([0.0, 0.0, 0.0], [1.0, 0.0, 1.0], "no extent"),
        ([0.0, 0.0, 2.0], [1.0, 1.0, 1.0], "no extent"),
        ([0.0, 0.0, 0.0], [1.0, math.inf, 1.0], "finite"),
        ([math.nan, 0.0, 0.0], [1.0, 1.0, 1.0], "finite"),
        ([0.0, 0.0], [1.0, 1.0], "corners"),
        ([1e9, 0.0, 0.0], [1e9 + 1.0, 1.0, 1.0], "no extent"),
    ],
)
def test_what_is_no_box_is_refused(lower: list[float], upper: list[float], complaint: str) -> None:
    with pytest.raises(VolumeError, match=complaint):
        DensityGrid(torch.ones(2, 2, 2), torch.tensor(lower), torch.tensor(upper))
    with pytest.raises(VolumeError):
        DensityGrid.from_voxel_size(torch.ones(2, 2, 2), -1.0)


def test_densities_of_other_types_are_taken() -> None:
    whole = DensityGrid(torch.ones(2, 2, 2, dtype=torch.int16), LOWER, UPPER)
    assert whole.density.dtype == torch.float32
    with pytest.raises(FrozenInstanceError):
        whole.density = torch.zeros(1, 1, 1)  # type: ignore[misc]


def chord(origin: list[float], direction: list[float]) -> tuple[float, float]:
    """Where a ray enters and leaves the box from (-2, -2.5, -3) to (2, 2.5, 3)."""
    near, far = uniform_box().intersect(torch.tensor([origin]), torch.tensor([direction]))
    return float(near), float(far)


def test_rays_along_the_axes() -> None:
    assert chord([-5.0, 0.0, 0.0], [1.0, 0.0, 0.0]) == (3.0, 7.0)
    assert chord([0.0, 5.0, 0.0], [0.0, -1.0, 0.0]) == (2.5, 7.5)
    assert chord([0.0, 0.0, -9.0], [0.0, 0.0, 1.0]) == (6.0, 12.0)
    assert chord([5.0, 0.0, 0.0], [1.0, 0.0, 0.0]) == (0.0, 0.0)


def test_rays_from_inside_start_at_zero() -> None:
    assert chord([1.0, 0.0, 0.0], [1.0, 0.0, 0.0]) == (0.0, 1.0)
    assert chord([1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]) == (0.0, 3.0)
    near, far = chord([0.0, 0.0, 0.0], [0.6, 0.8, 0.0])
    assert (near, far) == (0.0, pytest.approx(2.5 / 0.8))


def test_rays_parallel_to_faces() -> None:
    assert chord([-5.0, 2.5, 3.0], [1.0, 0.0, 0.0]) == (3.0, 7.0)  # along an edge of the box
    assert chord([-5.0, 2.6, 0.0], [1.0, 0.0, 0.0]) == (0.0, 0.0)
    assert chord([-2.0, -9.0, 0.0], [0.0, 1.0, 0.0]) == (6.5, 11.5)  # within a face
    assert chord([-2.1, -9.0, 0.0], [0.0, 1.0, 0.0]) == (0.0, 0.0)
    assert chord([-5.0, 2.6, 0.0], [1.0, -0.0, 0.0]) == (0.0, 0.0)
    assert chord([-2.0, -9.0, 0.0], [1e-42, 1.0, 0.0]) == (6.5, 11.5)  # its inverse overflows


def test_random_rays_meet_the_faces_and_missing_rays_nothing() -> None:
    grid = uniform_box()
    origin, direction = random_rays(grid, 500)
    near, far = grid.intersect(origin, direction)
    assert (far > near).all()
    for distance in (near, far):
        at = (origin + distance[:, None] * direction).abs() / grid.upper
        torch.testing.assert_close(at.amax(-1), torch.ones(500), atol=1e-4, rtol=0.0)
    near, far = grid.intersect(origin, -direction)
    assert torch.equal(near, torch.zeros(500))
    assert torch.equal(far, near)
