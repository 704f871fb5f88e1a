"""Rays keep what was decided about the ground, and points along them are those of the geometry."""

import math

import torch

from render.atmosphere.air_ray import AirRay
from tests.support.atmospheres import KM, just_below_horizon, planet, ray, tensor

PLANET = planet()
R = 1200.0 * KM


def test_the_ground_is_decided_once() -> None:
    below = ray(PLANET, R, just_below_horizon(PLANET, R, 1e-7), 0.3, 0.2)
    above = ray(PLANET, R, just_below_horizon(PLANET, R, -1e-7), 0.3, 0.2)
    assert bool(below.intersects_ground)
    assert not bool(above.intersects_ground)
    half = below.length(PLANET) * 0.5
    assert bool(below.at(PLANET, half).intersects_ground)
    denied = AirRay(*below.tensors()[:4], torch.tensor(False))
    assert not bool(denied.at(PLANET, half).intersects_ground)
    assert float(denied.length(PLANET)) > 1.5 * float(below.length(PLANET))


def test_a_point_straight_above() -> None:
    point = ray(PLANET, R, 1.0, 0.5, 0.5).at(PLANET, tensor(100.0 * KM))
    assert float(point.radius) == 1300.0 * KM
    assert float(point.cos_view) == 1.0
    assert float(point.cos_sun) == 0.5
    sideways = ray(PLANET, R, 0.0, 0.0, 1.0).at(PLANET, tensor(500.0 * KM))
    torch.testing.assert_close(sideways.radius, tensor(1300.0 * KM))
    torch.testing.assert_close(sideways.cos_sun, tensor(5.0 / 13.0))
    assert float(ray(PLANET, R, 0.0, 0.0, -1.0).at(PLANET, tensor(500.0 * KM)).cos_sun) < 0.0


def test_points_broadcast_along_rays() -> None:
    rays = AirRay.towards(PLANET, tensor(R), tensor(-0.9, 0.2, 0.8), tensor(0.4), tensor(0.1))
    assert [value.shape for value in rays.expanded().tensors()] == [torch.Size([3])] * 5
    points = rays.unsqueeze().at(PLANET, tensor(0.0, 1.0, 2.0, 3.0) * KM)
    assert points.radius.shape == (3, 4)
    assert math.isclose(float(points.radius[1, 0]), R)
