"""Single scattering in closed form, from optical depth 1e-6 to 1e4, and against plain quadrature in noise."""

import numpy as np
import pytest
import torch

from precompute.single_scattering import compute_single_scattering
from render.density_grid import DensityGrid
from render.free_flight import march_to_sun
from render.ray_march import march_rays
from tests.support.quadrature import box_single
from tests.support.volumes import noise_box, random_rays, scaled, smooth_box, towards, uniform_box

pytestmark = pytest.mark.usefixtures("loops")

DEPTHS = torch.tensor([1e-6, 1e-3, 0.1, 1.0, 5.0, 30.0, 200.0, 1e4])
LENGTH = 5.0
UNLIT = 5e-9  # beyond optical depth 20 to the sun nothing is measured, and exp(-20) is 2e-9
RAY = (torch.tensor([[0.3, -9.0, 0.4]]), torch.tensor([[0.0, 1.0, 0.0]]))


def compute(sun: torch.Tensor, grid: DensityGrid | None = None, sections: int = 32) -> torch.Tensor:
    """S1 `(depth,)`, each extinction by itself."""
    cloud = grid or uniform_box()
    single = [compute_single_scattering(cloud, *RAY, sun, depth[None] / LENGTH, 0.5, sections)[0] for depth in DEPTHS]
    return torch.cat(single).flatten()


def test_sun_behind_the_camera() -> None:
    expected = -0.5 * torch.expm1(-2.0 * DEPTHS)
    torch.testing.assert_close(compute(towards(180, 0)), expected, rtol=1e-4, atol=0.0)
    assert not torch.allclose(compute(towards(0, 0)), expected, rtol=0.05)


def test_sun_in_front_of_the_camera() -> None:
    expected = DEPTHS * torch.exp(-DEPTHS)
    torch.testing.assert_close(compute(towards(0, 0)), expected, rtol=1e-3, atol=UNLIT)
    assert not torch.allclose(compute(towards(180, 0)), expected, rtol=1e-3, atol=UNLIT)


@pytest.mark.parametrize(("sun", "way"), [((0, 90), 2.6), ((0, -90), 3.4), ((90, 0), 1.7), ((270, 0), 2.3)])
def test_sun_at_right_angles_also_below_the_horizon(sun: tuple[float, float], way: float) -> None:
    expected = torch.exp(-DEPTHS / LENGTH * way) * -torch.expm1(-DEPTHS)
    torch.testing.assert_close(compute(towards(*sun)), expected, rtol=1e-4, atol=UNLIT)
    wrong = torch.exp(-DEPTHS / LENGTH * (6.0 - way)) * -torch.expm1(-DEPTHS)
    assert not torch.allclose(compute(towards(*sun)), wrong, rtol=0.1, atol=UNLIT)


@pytest.mark.parametrize("sun", [(30, 40), (160, 10), (200, -35), (350, 5)])
def test_oblique_suns_by_quadrature(sun: tuple[float, float]) -> None:
    direction, half = towards(*sun), np.array([2.0, 2.5, 3.0])
    start = np.array([0.3, -2.5, 0.4])
    found = compute(direction, sections=400)
    for extinction, value in zip((DEPTHS / LENGTH).tolist(), found.tolist(), strict=True):
        exact = box_single(start, np.array([0.0, 1.0, 0.0]), direction.double().numpy(), half, extinction, 200_000)
        assert value == pytest.approx(exact, rel=3e-3, abs=UNLIT)


def test_thin_media_scatter_their_optical_depth() -> None:
    for sun in ((0, 0), (180, 0), (33, 21)):
        assert float(compute(towards(*sun))[0] / DEPTHS[0]) == pytest.approx(1.0, abs=1e-5)


def test_enormous_depth_stays_finite_and_below_one() -> None:
    for sun in ((0, 0), (180, 0), (33, 21), (200, 60)):
        for grid in (uniform_box(), noise_box(sparse=0.6), uniform_box(voxels=(1, 1, 1))):
            found = compute(towards(*sun), grid)
            assert torch.isfinite(found).all()
            assert (found >= 0.0).all()
            assert (found <= 1.0).all()


def test_a_cloud_by_plain_quadrature() -> None:
    grid, sun = smooth_box(), towards(120, 30)
    origin, direction = random_rays(grid, 40)
    extinction = torch.tensor([0.02, 0.1, 0.5])
    found, _ = compute_single_scattering(grid, origin, direction, sun, extinction, 0.05, 800)
    profile = march_rays(grid, origin, direction, 0.02)
    middle = 0.5 * (profile.distance[:, 1:] + profile.distance[:, :-1])
    points = origin[:, None] + middle[..., None] * direction[:, None]
    to_sun = march_to_sun(grid, points.reshape(-1, 3), sun, extinction[0], 0.1).reshape(middle.shape)
    to_camera = 0.5 * (profile.optical_length[:, 1:] + profile.optical_length[:, :-1])
    step = profile.optical_length.diff(dim=1)
    for s, image in zip(extinction, found, strict=True):
        expected = (s * step * torch.exp(-s * (to_camera + to_sun))).sum(1)
        torch.testing.assert_close(image, expected, rtol=0.01, atol=1e-4)
        assert not torch.allclose(image, (s * step * torch.exp(-s * to_camera)).sum(1), rtol=0.01, atol=1e-4)


def test_scenes_have_no_scale() -> None:
    grid, sun, extinction = noise_box(), towards(120, 30), torch.tensor([0.1, 2.0])
    origin, direction = random_rays(grid, 40)
    small, _ = compute_single_scattering(grid, origin, direction, sun, extinction, 0.5)
    large, _ = compute_single_scattering(scaled(grid, 512.0), 512.0 * origin, direction, sun, extinction / 512.0, 0.5)
    torch.testing.assert_close(large, small)


def test_rays_that_miss_and_empty_volumes_are_black() -> None:
    sun, extinction = towards(120, 30), torch.tensor([0.1, 2.0])
    empty = DensityGrid.from_voxel_size(torch.zeros(3, 3, 3), 1.0)
    origin, direction = random_rays(empty, 5)
    for grid, start in ((empty, origin), (noise_box(), origin + 99.0)):
        for found in compute_single_scattering(grid, start, direction, sun, extinction, 0.5):
            assert torch.equal(found, torch.zeros(2, 5))
    nothing = compute_single_scattering(noise_box(), origin[:0], direction[:0], sun, extinction, 0.5)
    assert [found.shape for found in nothing] == [(2, 0), (2, 0)]


@pytest.mark.parametrize("sections", [8, 16, 31])
def test_the_stated_error_is_that_of_the_sections(sections: int) -> None:
    grid, sun = noise_box(sparse=0.6), towards(20, 25)
    origin, direction = random_rays(grid, 400)
    extinction = torch.tensor([2.0, 8.0]) / float(grid.maximum)
    found, stated = compute_single_scattering(grid, origin, direction, sun, extinction, 0.05, sections)
    truth, _ = compute_single_scattering(grid, origin, direction, sun, extinction, 0.05, 1000)
    real, estimated = ((found - truth).square().mean(1).sqrt(), stated.square().mean(1).sqrt())
    assert bool((real > 1e-4).all())
    assert bool((estimated / real > 0.5).all() & (estimated / real < 2.0).all())
