"""Columns against closed forms, another rule and the golden transmittances."""

import math

import numpy as np
import pytest
import torch

from render.atmosphere import shells as module
from render.atmosphere.earth import OZONE_HALF_WIDTH, earth
from render.atmosphere.ray_geometry import (
    distance_to_nearest_boundary,
    distance_to_top_boundary,
    horizon_cosine,
    ray_intersects_ground,
)
from render.atmosphere.shells import (
    Shells,
    compute_columns,
    compute_exact_direct_irradiance,
    compute_exact_sun_transmittance,
    compute_exact_transmittance,
    cut_into_shells,
    mean_incidence,
    shell_crossings,
)
from render.atmosphere.transmittance import visible_sun_share
from tests.support.planets import golden, uniform_air


def random_rays(shells: Shells, count: int = 300) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Radii, cosines and distances to the end of the air."""
    generator = torch.Generator().manual_seed(4)
    planet = shells.atmosphere
    number = torch.rand(2, count, generator=generator, dtype=torch.float64)
    radius = planet.bottom_radius + planet.thickness * number[0] ** 3
    cosine = 2.0 * number[1] - 1.0
    hit = ray_intersects_ground(planet, radius, cosine)
    return radius, cosine, distance_to_nearest_boundary(planet, radius, cosine, hit)


def test_columns_of_uniform_air_are_distances() -> None:
    shells = cut_into_shells(uniform_air(1e-5))
    radius, cosine, distance = random_rays(shells)
    columns = compute_columns(shells, radius, cosine, distance)[:, 1]
    torch.testing.assert_close(columns, distance, rtol=1e-12, atol=1e-6)
    assert not torch.allclose(columns, 1.001 * distance)


def test_vertical_columns_are_those_of_the_profiles() -> None:
    shells = cut_into_shells(earth())
    up = torch.tensor([1.0], dtype=torch.float64)
    found = compute_columns(shells, shells.radii[:1], up, torch.tensor([60_000.0], dtype=torch.float64))[0]
    exact = [h * -math.expm1(-60_000.0 / h) for h in (8000.0, 1200.0)] + [OZONE_HALF_WIDTH]
    np.testing.assert_allclose(found.numpy(), exact, rtol=1e-9)
    half = compute_columns(shells, shells.radii[:1], up, torch.tensor([30_000.0], dtype=torch.float64))[0]
    assert abs(float(half[2]) / OZONE_HALF_WIDTH - 1.0) > 0.1


def test_more_nodes_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    shells = cut_into_shells(earth())
    rays = random_rays(shells)
    columns = compute_columns(shells, *rays)
    monkeypatch.setattr(module, "PIECE_NODES", 12)
    torch.testing.assert_close(compute_columns(shells, *rays), columns, rtol=3e-8, atol=1e-3)
    monkeypatch.setattr(module, "PIECE_NODES", 1)
    assert float((compute_columns(shells, *rays) - columns).abs().max()) > 100.0


def test_crossings_lie_on_the_spheres_in_order() -> None:
    shells = cut_into_shells(earth())
    radius, cosine, distance = random_rays(shells)
    at = shell_crossings(shells, radius, cosine, distance)
    assert bool((at[:, 1:] >= at[:, :-1]).all())
    torch.testing.assert_close(at[:, -1], distance)
    ray, piece = torch.nonzero((at[:, 1:-1] > 0.0) & (at[:, 1:-1] < distance[:, None]), as_tuple=True)
    there = torch.sqrt(radius**2 + 2.0 * radius * cosine * at[:, 1:-1].T + at[:, 1:-1].T ** 2).T[ray, piece]
    nearest_point = (radius * cosine)[ray] + at[:, 1:-1][ray, piece]
    on_a_sphere = (there[:, None] - shells.radii).abs().amin(1) < 1e-4
    assert bool((on_a_sphere | (nearest_point.abs() < 1e-6)).all())


def test_columns_add_up_along_a_ray() -> None:
    shells = cut_into_shells(earth())
    radius, cosine, distance = random_rays(shells)
    whole, near = (
        compute_columns(shells, radius, cosine, distance),
        compute_columns(shells, radius, cosine, 0.3 * distance),
    )
    assert bool((whole >= near).all())
    assert bool((near >= 0.0).all())
    back = compute_columns(shells, radius, cosine, torch.zeros_like(distance))
    assert bool((back == 0.0).all())


def test_transmittances_are_those_of_an_independent_integrator() -> None:
    shells = cut_into_shells(earth())
    rows = golden("transmittance")
    radius, cosine = torch.from_numpy(rows["r_m"]), torch.from_numpy(rows["mu"])
    to_top = distance_to_top_boundary(shells.atmosphere, radius, cosine)
    found = compute_exact_transmittance(shells, radius, cosine, to_top)
    np.testing.assert_allclose(found.numpy(), rows["T_exact"], atol=1e-8)
    assert np.abs(found.numpy() - rows["T_texture"]).max() > 1e-5
    segment = [torch.from_numpy(rows[name]) for name in ("seg_r_m", "seg_mu", "seg_d_m")]
    np.testing.assert_allclose(compute_exact_transmittance(shells, *segment).numpy(), rows["seg_T_exact"], atol=1e-8)


def test_the_sun_rises_over_the_width_of_its_disc() -> None:
    planet = earth()
    radius = torch.tensor([planet.bottom_radius, planet.bottom_radius + 9000.0], dtype=torch.float64)
    horizon = horizon_cosine(planet, radius)
    width = planet.bottom_radius / radius * planet.sun_angular_radius
    for offset, share in ((-1.0, 0.0), (0.0, 0.5), (1.0, 1.0)):
        torch.testing.assert_close(
            visible_sun_share(planet, radius, horizon + offset * width), torch.full_like(radius, share)
        )
    shells = cut_into_shells(planet)
    light = compute_exact_sun_transmittance(shells, radius, horizon + torch.tensor([[-1.001], [-0.5], [0.5]]) * width)
    assert bool((light[0] == 0.0).all())
    assert bool((light[2] > light[1]).all())
    assert bool((light[1] > 0.0).all())


def test_the_mean_incidence_is_that_of_the_disc_and_continuous() -> None:
    planet = earth()
    a = planet.sun_angular_radius
    cosine = torch.tensor([-2.0 * a, -a, 0.0, a, 0.5], dtype=torch.float64)
    exact = torch.tensor([0.0, 0.0, 0.25 * a, a, 0.5], dtype=torch.float64)
    torch.testing.assert_close(mean_incidence(planet, cosine), exact)
    shells = cut_into_shells(uniform_air(0.0))
    solar = shells.atmosphere.solar_irradiance[0]
    torch.testing.assert_close(compute_exact_direct_irradiance(shells, cosine)[:, 0], solar * exact)
