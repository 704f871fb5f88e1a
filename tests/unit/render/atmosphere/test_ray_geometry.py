"""Distances and horizons against closed forms, on both sides of each boundary."""

import math
from decimal import Decimal, localcontext

import pytest
import torch

from render.atmosphere.earth import earth
from render.atmosphere.ray_geometry import (
    clamp_cosine,
    clamp_distance,
    clamp_radius,
    distance_to_bottom_boundary,
    distance_to_nearest_boundary,
    distance_to_top_boundary,
    horizon_cosine,
    horizon_distance,
    radius_along_ray,
    ray_intersects_ground,
    safe_sqrt,
    sine_from_cosine,
    sun_cosine_along_ray,
    view_cosine_along_ray,
)
from tests.support.atmospheres import KM, planet, tensor

PLANET = planet()
R = 1200.0 * KM


def test_the_way_to_the_top_straight_up_and_horizontally() -> None:
    assert float(distance_to_top_boundary(PLANET, tensor(R), tensor(1.0))) == pytest.approx(300.0 * KM, abs=1.0)
    level = math.sqrt(1500.0**2 - 1200.0**2) * KM
    assert float(distance_to_top_boundary(PLANET, tensor(R), tensor(0.0))) == pytest.approx(level, abs=1.0)
    assert float(distance_to_top_boundary(PLANET, tensor(R), tensor(-1.0))) == pytest.approx(2700.0 * KM, abs=1.0)
    assert float(distance_to_top_boundary(PLANET, tensor(R), tensor(0.1))) != pytest.approx(level, abs=KM)


def test_the_horizon_separates_rays_that_meet_the_ground() -> None:
    horizon = float(horizon_cosine(PLANET, tensor(R)))
    assert horizon == pytest.approx(-math.sqrt(1.0 - (1000.0 / 1200.0) ** 2))
    cosines = tensor(1.0, horizon + 1e-3, horizon - 1e-3, -1.0)
    assert ray_intersects_ground(PLANET, tensor(R), cosines).tolist() == [False, False, True, True]
    ground = tensor(PLANET.bottom_radius)
    assert ray_intersects_ground(PLANET, ground, tensor(-1e-9, 0.0, 1e-9)).tolist() == [True, False, False]


def test_the_way_to_the_nearest_boundary_up_horizontally_and_down() -> None:
    cosines = tensor(1.0, 0.0, -1.0)
    expected = tensor(300.0, math.sqrt(1500.0**2 - 1200.0**2), 200.0) * KM
    ground = ray_intersects_ground(PLANET, tensor(R), cosines)
    found = distance_to_nearest_boundary(PLANET, tensor(R), cosines, ground)
    torch.testing.assert_close(found, expected, atol=1.0, rtol=0.0)
    assert not torch.allclose(distance_to_nearest_boundary(PLANET, tensor(R), cosines, ~ground), expected)


@pytest.mark.parametrize("altitude", [1e-3, 1.0, 100.0, 59_999.0])
def test_short_ways_keep_their_digits(altitude: float) -> None:
    """Straight up to a near top or down to a near ground, where the plain root of the quadratic cancels."""
    atmosphere = earth()
    low, high = tensor(atmosphere.bottom_radius + altitude), tensor(atmosphere.top_radius - altitude)
    up = distance_to_top_boundary(atmosphere, high, tensor(0.5))
    down = distance_to_bottom_boundary(atmosphere, low, tensor(-0.5))
    for found, radius, boundary in ((up, high, atmosphere.top_radius), (down, low, atmosphere.bottom_radius)):
        r, b = Decimal(float(radius)), Decimal(boundary)
        with localcontext(prec=50):
            root = (b * b - r * r * Decimal("0.75")).sqrt()
        exact = root - r / 2 if boundary > float(radius) else r / 2 - root
        assert float(found) == pytest.approx(float(exact), rel=1e-11)


def test_points_along_a_ray_are_where_vectors_say() -> None:
    generator = torch.Generator().manual_seed(3)
    position = torch.randn(100, 3, generator=generator, dtype=torch.float64)
    position = position / position.norm(dim=-1, keepdim=True) * R
    view, sun = (
        torch.nn.functional.normalize(torch.randn(100, 3, generator=generator, dtype=torch.float64), dim=-1)
        for _ in "ab"
    )
    cosine, cos_sun = (position * view).sum(-1) / R, (position * sun).sum(-1) / R
    distance = torch.full((100,), 150.0 * KM, dtype=torch.float64)
    there = position + distance[:, None] * view
    expected = there.norm(dim=-1).clamp(PLANET.bottom_radius, PLANET.top_radius)
    radius = radius_along_ray(PLANET, tensor(R), cosine, distance)
    torch.testing.assert_close(radius, expected)
    torch.testing.assert_close(
        view_cosine_along_ray(tensor(R), cosine, distance, radius), (there * view).sum(-1) / expected
    )
    view_sun = (view * sun).sum(-1)
    found = sun_cosine_along_ray(tensor(R), cos_sun, view_sun, distance, radius)
    torch.testing.assert_close(found, (there * sun).sum(-1) / expected)
    assert not torch.allclose(found, sun_cosine_along_ray(tensor(R), cos_sun, -view_sun, distance, radius))


def test_nowhere_along_a_ray_is_the_ray_itself() -> None:
    radius = tensor(6_360_000.0, 6_360_001.0, 6_419_999.0)
    assert torch.equal(radius_along_ray(earth(), radius, tensor(-0.3), tensor(0.0)), radius)


def test_guards() -> None:
    assert clamp_cosine(tensor(-1.1, 0.3, 1.1)).tolist() == [-1.0, 0.3, 1.0]
    assert clamp_distance(tensor(-1e-9, 2.0)).tolist() == [0.0, 2.0]
    assert clamp_radius(PLANET, tensor(1.0, R, 1e9)).tolist() == [PLANET.bottom_radius, R, PLANET.top_radius]
    assert sine_from_cosine(tensor(1.0, 0.6, -1.0 - 1e-16)).tolist() == pytest.approx([0.0, 0.8, 0.0])
    assert float(horizon_distance(PLANET, tensor(PLANET.bottom_radius))) == 0.0
    square = tensor(-1e-9, 0.0, 4.0).requires_grad_()
    root = safe_sqrt(square)
    root.sum().backward()
    assert root.tolist() == [0.0, 0.0, 2.0]
    assert square.grad is not None
    assert square.grad.tolist() == [0.0, 0.0, 0.25]


def test_nothing_is_nan_on_the_boundaries() -> None:
    atmosphere = earth()
    radius = tensor(atmosphere.bottom_radius, atmosphere.bottom_radius + 1e-9, atmosphere.top_radius)[:, None]
    cosine = tensor(-1.0, -1e-9, 0.0, 1e-9, 1.0)
    for distance in (distance_to_top_boundary, distance_to_bottom_boundary):
        found = distance(atmosphere, radius, cosine)
        assert bool(((found >= 0.0) & (found < 1e8)).all())
