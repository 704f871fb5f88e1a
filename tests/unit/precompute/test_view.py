"""The rays that see cloud, all of them and some of them."""

import math

import pytest
import torch

from precompute.view import view_of
from render.camera import PinholeCamera
from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.ray_march import compute_optical_length
from tests.support.volumes import noise_box, towards, uniform_box, view_north

SUN = towards(120.0, 30.0)


def test_rays_are_those_with_an_optical_length() -> None:
    grid, camera = noise_box(), view_north(8, 6, 9.0)
    view = view_of(grid, camera, SUN)
    origin, direction = camera.rays()
    length = compute_optical_length(grid, origin, direction)
    assert 0 < len(view.pixel) < 48
    assert torch.equal(view.pixel, torch.nonzero(length).flatten())
    assert torch.equal(view.optical_length, length[length > 0])
    assert torch.equal(view.origin, origin[view.pixel])
    assert torch.equal(view.direction, direction[view.pixel])
    assert view.largest_optical_length == float(length.max())


def test_a_uniform_box_is_as_long_as_it_is_deep() -> None:
    view = view_of(uniform_box(), view_north(5, 5, 8.0), SUN)
    torch.testing.assert_close(view.optical_length, torch.full_like(view.optical_length, 5.0))


def test_parts_hold_some_of_the_rays() -> None:
    view = view_of(noise_box(), view_north(8, 6, 9.0), SUN)
    rays = torch.tensor([5, 0, 7])
    part = view.part(rays)
    for name in ("pixel", "origin", "direction", "optical_length"):
        assert torch.equal(getattr(part, name), getattr(view, name)[rays])
    assert (part.grid, part.camera) == (view.grid, view.camera)
    assert torch.equal(part.sun, view.sun)
    assert part.part(rays[:0]).largest_optical_length == 0.0


@pytest.mark.parametrize("grid", [DensityGrid.from_voxel_size(torch.zeros(3, 3, 3), 1.0), noise_box()])
def test_views_beside_the_cloud_have_no_rays(grid: DensityGrid) -> None:
    view = view_of(grid, PinholeCamera((0.0, -9.0, 0.0), (0.0, -10.0, 0.0), 0.5, 3, 2), SUN)
    assert len(view.pixel) == len(view.origin) == 0
    assert view.largest_optical_length == 0.0


def test_the_sun_has_length_one_and_must_have_a_direction() -> None:
    torch.testing.assert_close(view_of(noise_box(), view_north(), 7.0 * SUN).sun, SUN)
    for sun in (torch.zeros(3), torch.tensor([0.0, math.nan, 1.0])):
        with pytest.raises(ParameterError, match="direction"):
            view_of(noise_box(), view_north(), sun)
