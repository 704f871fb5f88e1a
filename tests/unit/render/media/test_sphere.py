"""The sun over round ground: the parabola against the sphere, the whole of S against plain quadrature in space."""

import itertools
import math

import numpy as np
import pytest
import torch

from render.media import ExponentialDecay, LinearDecay, Uniform, compute_curved_in_scattering, compute_in_scattering
from render.media.sphere import EARTH_RADIUS, curvature, distance_to_top, shadowed
from tests.support.round_fog import round_in_scattering

EYE = 300.0
ROUND = {
    "uniform": (Uniform(1e-4, 1000.0), lambda h: np.where(h <= 1000.0, 1e-4, 0.0), 1000.0),
    "linear": (LinearDecay(2e-4, 1000.0), lambda h: np.where(h <= 1000.0, 2e-4 * (1.0 - h / 1000.0), 0.0), 1000.0),
    "exponential": (ExponentialDecay(5e-5, 1200.0), lambda h: 5e-5 * np.exp(-h / 1200.0), 50_000.0),
}


def numbers(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_a_ray_rises_as_over_a_sphere() -> None:
    for slope in (-0.003, 0.0, 0.01, 0.5):
        s = 2e4
        exact = math.sqrt(EARTH_RADIUS**2 + 2.0 * EARTH_RADIUS * slope * s + s * s) - EARTH_RADIUS
        rise = slope * s + 0.5 * curvature(numbers(slope), EARTH_RADIUS).item() * s * s
        assert rise == pytest.approx(exact, abs=s**3 / EARTH_RADIUS**2)
        if rise > 0.0:
            assert distance_to_top(numbers(rise), numbers(slope), EARTH_RADIUS).item() == pytest.approx(s, rel=1e-9)


def test_the_ground_hides_a_sun_below_the_dip_of_the_horizon() -> None:
    """From h metres the horizon lies sqrt(2 h / R) below the level."""
    dip = math.sqrt(2.0 * 500.0 / EARTH_RADIUS)
    slopes = numbers(-1.01 * dip, -0.99 * dip, 0.0, 0.5)
    assert shadowed(numbers(500.0), 0.0, slopes, EARTH_RADIUS).tolist() == [True, False, False, False]
    assert not shadowed(numbers(500.0), -math.inf, numbers(-0.5), EARTH_RADIUS).item()


@pytest.mark.parametrize("name", ROUND)
@pytest.mark.parametrize(("degrees", "tolerance"), [(0.0, 3e-3), (1.0, 1e-3), (5.0, 2e-5), (30.0, 1e-7)])
def test_the_path_to_the_sun_is_the_spherical_one(name: str, degrees: float, tolerance: float) -> None:
    medium, extinction, ceiling = ROUND[name]
    sun_slope = math.sin(math.radians(degrees))
    for slope, distance in ((0.0, 1e4), (-0.02, 1e4), (0.02, 5e3)):
        expected = round_in_scattering(extinction, ceiling, EYE, slope, sun_slope, distance, EARTH_RADIUS, None)
        value = compute_curved_in_scattering(medium, numbers(EYE), slope, sun_slope, EARTH_RADIUS, distance, pieces=16)
        assert value.item() == pytest.approx(expected, rel=tolerance)
        flat = compute_in_scattering(medium, numbers(EYE), slope, sun_slope, distance)
        assert flat.item() != pytest.approx(expected, rel=tolerance)


@pytest.mark.parametrize("name", ROUND)
@pytest.mark.parametrize(("degrees", "tolerance"), [(0.0, 0.05), (1.0, 0.012), (5.0, 0.0025)])
def test_ten_kilometres_of_level_view_over_round_ground(name: str, degrees: float, tolerance: float) -> None:
    medium, extinction, ceiling = ROUND[name]
    sun_slope = math.sin(math.radians(degrees))
    for azimuth in (0.0, 0.5 * math.pi, math.pi):
        expected = round_in_scattering(extinction, ceiling, EYE, 0.0, sun_slope, 1e4, EARTH_RADIUS, azimuth)
        cosine = math.cos(azimuth) * math.cos(math.radians(degrees))
        arguments = (medium, numbers(EYE), 0.0, sun_slope, EARTH_RADIUS, 1e4)
        assert compute_curved_in_scattering(*arguments, cosine).item() == pytest.approx(expected, rel=tolerance)
        if azimuth == 0.0:
            assert compute_curved_in_scattering(*arguments, -cosine).item() != pytest.approx(expected, rel=tolerance)


def test_the_error_falls_with_the_square_of_the_pieces() -> None:
    medium, extinction, ceiling = ROUND["uniform"]
    expected = round_in_scattering(extinction, ceiling, EYE, 0.02, 0.02, 3e4, EARTH_RADIUS, None)
    errors = [
        abs(
            compute_curved_in_scattering(medium, numbers(EYE), 0.02, 0.02, EARTH_RADIUS, 3e4, pieces=n).item()
            / expected
            - 1.0
        )
        for n in (1, 2, 4, 8)
    ]
    assert all(3.0 < a / b < 6.0 for a, b in itertools.pairwise(errors))
