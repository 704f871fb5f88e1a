"""Rays from vectors, and what is refused."""

import pytest
import torch

from render.atmosphere.earth import earth
from render.atmosphere.rays import chosen_rays, rays_from_vectors
from render.errors import ParameterError
from tests.support.planets import one_ray

SUN = torch.tensor([0.6, 0.0, 0.8], dtype=torch.float64)


def test_cosines_are_those_of_the_vectors() -> None:
    planet = earth()
    position = torch.tensor([[0.0, planet.bottom_radius + 1000.0, 0.0]], dtype=torch.float64)
    down = torch.tensor([[0.0, -1.0, 0.0]], dtype=torch.float64)
    for direction, cosine, ground in ((down, -1.0, True), (-down, 1.0, False)):
        rays = rays_from_vectors(planet, position, direction, SUN)
        assert float(rays.cos_view) == cosine
        assert bool(rays.intersects_ground) is ground
        assert float(rays.cos_view_sun) == float(rays.cos_sun) == 0.0
        assert float(rays.length(planet)) == pytest.approx(1000.0 if ground else 59_000.0)


def test_a_position_outside_the_air_is_refused() -> None:
    planet = earth()
    for radius in (planet.bottom_radius - 1.0, planet.top_radius + 1.0, float("nan")):
        with pytest.raises(ParameterError, match="from the planet's centre"):
            rays_from_vectors(planet, torch.tensor([[0.0, 0.0, radius]], dtype=torch.float64), SUN[None], SUN)
    top = torch.tensor([[0.0, 0.0, planet.top_radius * (1.0 + 1e-15)]], dtype=torch.float64)
    assert float(rays_from_vectors(planet, top, SUN[None], SUN).radius) == planet.top_radius


def test_some_rays_are_chosen_by_number_or_mask() -> None:
    ray = one_ray(6.36e6, 0.5, 0.4, 0.3)
    assert chosen_rays(ray, torch.tensor([0, 0])).cos_sun.tolist() == [0.4, 0.4]
    assert chosen_rays(ray, torch.tensor([False])).radius.shape == (0,)
