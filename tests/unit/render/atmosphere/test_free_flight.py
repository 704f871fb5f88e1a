"""Free flights against the exact distribution, and the weights of paths."""

import numpy as np
import pytest
import torch

from render.atmosphere.air_ray import AirRay
from render.atmosphere.earth import earth
from render.atmosphere.free_flight import Weights, fly
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.rays import chosen_rays
from render.atmosphere.shells import compute_columns, compute_exact_transmittance, cut_into_shells
from tests.support.planets import one_ray, uniform_air
from tests.support.statistics import histogram_p_value, passes_z_test

COUNT = 4000


def flights(planet: AtmosphereParameters, ray: AirRay, forced: bool, hero: int = 0) -> tuple:
    generator = torch.Generator().manual_seed(7)
    uniform = torch.rand(COUNT, generator=generator, dtype=torch.float64)
    rays = chosen_rays(ray, torch.zeros(COUNT, dtype=torch.long))
    weights = Weights.ones(COUNT, len(planet.wavelengths))
    heroes = torch.full((COUNT,), hero)
    return fly(cut_into_shells(planet), rays, torch.full((COUNT,), forced), heroes, weights, uniform)


def test_distances_in_uniform_air_are_exponential() -> None:
    planet = uniform_air(2e-5)
    distance, on_ground, alive, _ = flights(planet, one_ray(planet.bottom_radius, 1.0, 1.0, 1.0), False)
    assert bool(alive.all())
    assert not bool(on_ground.any())
    edges = np.linspace(0.0, 60_000.0, 21)
    counts = np.histogram(distance.numpy(), edges)[0]
    for extinction, right in ((2e-5, True), (3e-5, False)):
        share = -np.diff(np.exp(-extinction * edges)) / -np.expm1(-extinction * 60_000.0)
        assert (histogram_p_value(counts, COUNT * share) > 1e-3) is right


@pytest.mark.parametrize("forced", [False, True])
def test_weights_give_the_scattered_share_of_every_wavelength(forced: bool) -> None:
    """The mean of extinction times the weight is the share of light that does not pass, whatever the hero."""
    planet = earth()
    shells = cut_into_shells(planet)
    ray = one_ray(planet.bottom_radius + 9000.0, -0.3, 0.5, 0.0, ground=True)
    for hero in range(3):
        distance, on_ground, _, weights = flights(planet, ray, forced, hero)
        there = torch.hypot(ray.radius * ray.cos_view + distance, ray.radius * (1.0 - ray.cos_view**2).sqrt())
        step = torch.tensor([1.0], dtype=torch.float64)
        extinction = compute_columns(shells, there, torch.ones_like(there), step) @ shells.extinction
        # With one hero alone the density of its own choice stands in the denominator.
        value = torch.where(on_ground[:, None], 0.0, extinction * weights.contribution / weights.density[:, hero, None])
        end = ray.length(planet)
        opacity = 1.0 - compute_exact_transmittance(shells, ray.radius, ray.cos_view, end)[0]
        for factor, right in ((1.0, True), (1.3, False)):
            error = value.mean(0) - factor * opacity
            assert passes_z_test(error, value.var(0) / COUNT) is right
        assert bool(on_ground.any()) is not forced


def test_nothing_collides_where_nothing_is() -> None:
    planet = uniform_air(0.0)
    _, on_ground, alive, _ = flights(planet, one_ray(planet.bottom_radius, 1.0, 1.0, 1.0), False)
    assert not bool(alive.any())
    down = one_ray(planet.top_radius, -1.0, 1.0, -1.0, ground=True)
    distance, on_ground, alive, weights = flights(planet, down, False)
    assert bool((on_ground & alive).all())
    torch.testing.assert_close(distance, torch.full_like(distance, 60_000.0))
    assert bool((weights.estimate() == 1.0).all())


def test_the_balance_heuristic_takes_the_mean_over_heroes() -> None:
    one = torch.ones(1, 2, dtype=torch.float64)
    weights = Weights.ones(1, 2).times(torch.tensor([[1.0, 4.0]]), torch.tensor([[1.0, 3.0]])).times(one, one)
    torch.testing.assert_close(weights.estimate(), torch.tensor([[0.5, 2.0]], dtype=torch.float64))
    assert weights.joined(weights)[torch.tensor([1])].density.shape == (1, 2)
