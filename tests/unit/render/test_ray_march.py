"""Optical lengths against closed forms, along axes, edges and from inside, and free of scale."""

import pytest
import torch

from render import ray_march
from render.density_grid import DensityGrid
from render.ray_march import compute_optical_length, interpolate_in_rows, locate_in_rows, march_rays, ray_chunks
from tests.support.volumes import noise_box, ramp_box, random_rays, scaled, uniform_box


def one_ray(
    origin: tuple[float, float, float], direction: tuple[float, float, float]
) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.tensor([origin]), torch.nn.functional.normalize(torch.tensor([direction]), dim=-1)


def test_a_uniform_box_has_the_length_of_the_chord() -> None:
    grid = uniform_box(density=0.5)
    origin, direction = random_rays(grid, 300)
    near, far = grid.intersect(origin, direction)
    found = compute_optical_length(grid, origin, direction)
    torch.testing.assert_close(found, 0.5 * (far - near), rtol=1e-5, atol=1e-5)
    assert not torch.allclose(found, far - near, rtol=0.1)


@pytest.mark.parametrize(
    ("origin", "direction", "expected"),
    [
        ((-9.0, 0.0, 0.0), (1.0, 0.0, 0.0), 4.0),
        ((0.0, 9.0, 0.0), (0.0, -1.0, 0.0), 5.0),
        ((0.0, 0.0, -9.0), (0.0, 0.0, 1.0), 6.0),
        ((-9.0, -0.5, 1.0), (1.0, 0.0, 0.0), 4.0),  # along edges of voxels
        ((-9.0, 2.5, 3.0), (1.0, 0.0, 0.0), 4.0),  # along an edge of the box
        ((0.5, 0.0, 0.0), (1.0, 0.0, 0.0), 1.5),  # from inside
        ((9.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0),
        ((-9.0, 2.6, 0.0), (1.0, 0.0, 0.0), 0.0),
    ],
)
def test_rays_along_axes_and_edges(
    origin: tuple[float, float, float], direction: tuple[float, float, float], expected: float
) -> None:
    assert float(compute_optical_length(uniform_box(), *one_ray(origin, direction))) == pytest.approx(
        expected, rel=1e-6
    )


def ramp_integral(x: torch.Tensor) -> torch.Tensor:
    """Integral from 0 to x of the density of `ramp_box()`: linear between 0.25 m and 7.75 m, held beyond."""
    inner = x.clamp(0.25, 7.75)
    return 0.25 * (0.5 * inner.square() - 0.5 * 0.25**2 + 0.25 * x.clamp(0.0, 0.25) + 7.75 * (x - 7.75).clamp(min=0.0))


def test_a_ramp_is_integrated_exactly() -> None:
    grid = ramp_box()
    profile = march_rays(grid, *one_ray((-1.0, 0.1, 0.2), (1.0, 0.0, 0.0)))
    torch.testing.assert_close(profile.distance[0, [0, -1]], torch.tensor([1.0, 9.0]))
    torch.testing.assert_close(
        profile.optical_length[0], ramp_integral(profile.distance[0] - 1.0), rtol=1e-5, atol=1e-6
    )
    backwards = march_rays(grid, *one_ray((9.0, 0.1, 0.2), (-1.0, 0.0, 0.0)))
    torch.testing.assert_close(backwards.total, profile.total)
    assert not torch.allclose(backwards.optical_length, profile.optical_length, atol=0.1)


def test_profiles_rise_from_zero_to_the_total() -> None:
    grid = noise_box()
    origin, direction = random_rays(grid, 100)
    profile = march_rays(grid, origin, direction)
    assert torch.equal(profile.optical_length[:, 0], torch.zeros(100))
    assert (profile.optical_length.diff(dim=1) >= 0.0).all()
    assert torch.equal(profile.total, profile.optical_length[:, -1])


def test_whole_rays_are_as_long_as_their_profiles() -> None:
    grid = noise_box()
    rays = random_rays(grid, 100)
    fine = [march_rays(grid, *rays, 0.01).total, compute_optical_length(grid, *rays, 0.01)]
    torch.testing.assert_close(*fine, rtol=1e-4, atol=1e-4)


def test_smaller_steps_come_closer() -> None:
    grid = noise_box()
    origin, direction = random_rays(grid, 200)
    exact = compute_optical_length(grid, origin, direction, step=0.005)
    errors = [
        float((compute_optical_length(grid, origin, direction, step) - exact).norm() / exact.norm())
        for step in (1.0, 0.5, 0.1)
    ]
    assert errors[0] > 2.0 * errors[1] > 8.0 * errors[2]
    assert errors[1] < 0.02


def test_a_profile_is_the_integral_of_the_density_looked_up() -> None:
    grid = noise_box()
    origin, direction = random_rays(grid, 20)
    near, far = grid.intersect(origin, direction)
    middle = (torch.arange(4000) + 0.5) / 4000
    points = origin[:, None] + (near[:, None] + (far - near)[:, None] * middle)[..., None] * direction[:, None]
    expected = grid.look_up_density(points).double().mean(1) * (far - near)
    torch.testing.assert_close(
        compute_optical_length(grid, origin, direction, 0.01).double(), expected, rtol=1e-3, atol=1e-4
    )


@pytest.mark.parametrize("factor", [1e-3, 1e4])
def test_lengths_scale_with_the_scene(factor: float) -> None:
    grid = noise_box()
    origin, direction = random_rays(grid, 100)
    expected = factor * compute_optical_length(grid, origin, direction)
    found = compute_optical_length(scaled(grid, factor), factor * origin, direction)
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-4 * factor)


def test_empty_volumes_single_voxels_and_no_rays() -> None:
    empty = DensityGrid.from_voxel_size(torch.zeros(3, 3, 3), 1.0)
    origin, direction = random_rays(empty, 10)
    assert torch.equal(compute_optical_length(empty, origin, direction), torch.zeros(10))
    voxel = DensityGrid.from_voxel_size(torch.full((1, 1, 1), 2.0), 3.0)
    assert float(compute_optical_length(voxel, *one_ray((0.0, -9.0, 1.0), (0.0, 1.0, 0.0)))) == pytest.approx(6.0)
    assert compute_optical_length(voxel, torch.zeros(0, 3), torch.zeros(0, 3)).shape == (0,)


def test_memory_is_bounded_by_chunks_that_cover_all_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    grid = noise_box()
    origin, direction = random_rays(grid, 50)
    expected = compute_optical_length(grid, origin, direction)
    monkeypatch.setattr(ray_march, "PROFILE_SAMPLES", 100)
    chunks = list(ray_chunks(grid, 50))
    assert [i for chunk in chunks for i in range(chunk.start, chunk.stop)] == list(range(50))
    assert max(chunk.stop - chunk.start for chunk in chunks) * 2.0 * grid.radius / 0.5 <= 100
    torch.testing.assert_close(compute_optical_length(grid, origin, direction), expected, rtol=0.02, atol=0.02)


def test_rows_are_inverted_where_they_rise() -> None:
    known = torch.tensor([[0.0, 1.0, 1.0, 3.0], [0.0, 0.0, 2.0, 2.0]])
    places = torch.tensor([[0.0, 1.0, 2.0, 3.0], [10.0, 11.0, 12.0, 13.0]])
    cell, fraction = locate_in_rows(known, torch.tensor([[0.0, 0.5, 2.0], [0.0, 1.0, 1.9]]))
    expected = torch.tensor([[0.0, 0.5, 2.5], [11.0, 11.5, 11.95]])
    torch.testing.assert_close(interpolate_in_rows(places, cell, fraction), expected)
    torch.testing.assert_close(interpolate_in_rows(known, cell, fraction)[0], torch.tensor([0.0, 0.5, 2.0]))


def test_flat_stretches_end_at_their_end_and_targets_beyond_at_the_last_edge() -> None:
    known = torch.tensor([[0.0, 1.0, 1.0, 3.0]])
    cell, fraction = locate_in_rows(known, torch.tensor([[1.0, 3.0, 99.0]]))
    at = interpolate_in_rows(torch.tensor([[0.0, 1.0, 2.0, 3.0]]), cell, fraction)
    assert at.tolist() == [[2.0, 3.0, 3.0]]
