import math

import pytest
import torch

from render.gradient_sky import HORIZON, air_mass, look_up_gradient_sky, sunlight_through_air

WHITE = torch.ones(3, dtype=torch.float64)


def toward(elevation: float) -> torch.Tensor:
    return torch.tensor([0.0, math.cos(elevation), math.sin(elevation)], dtype=torch.float64)


def test_air_mass_is_one_overhead_and_thirty_eight_at_the_horizon() -> None:
    assert air_mass(0.5 * math.pi) == pytest.approx(1.0, abs=1e-3)
    assert air_mass(math.radians(30.0)) == pytest.approx(2.0, rel=5e-3)
    assert air_mass(0.0) == pytest.approx(38.0, rel=5e-3)
    assert air_mass(-0.5) == air_mass(0.0)


def test_sunlight_reddens_as_the_sun_sinks() -> None:
    high, low = sunlight_through_air(1.2), sunlight_through_air(0.1)
    assert high[0] > high[1] > high[2]
    assert low[2] / low[0] < 0.5 * high[2] / high[0]
    assert all(a > b for a, b in zip(high, low, strict=True))


def test_the_sky_brightens_towards_the_sun_and_blues_towards_the_zenith() -> None:
    sun = toward(0.7)
    at_sun, away, up = (
        look_up_gradient_sky(d, sun, WHITE) for d in (sun, toward(math.pi - 0.7), toward(0.5 * math.pi))
    )
    assert (at_sun > away).all()
    assert up[2] / up[0] > away[2] / away[0]
    level = look_up_gradient_sky(torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64), sun, WHITE)
    torch.testing.assert_close(level, torch.tensor(HORIZON, dtype=torch.float64), rtol=1e-6, atol=0.0)
    below = look_up_gradient_sky(torch.tensor([1.0, 0.0, -0.0], dtype=torch.float64), sun, WHITE)
    assert torch.equal(level, below)


def test_a_level_sun_leaves_a_coloured_twilight() -> None:
    light = torch.tensor([1.0, 0.5, 0.1], dtype=torch.float64)
    sun = toward(0.0)
    near = look_up_gradient_sky(toward(0.05), sun, light)
    assert near[0] > near[2]
    assert torch.isfinite(look_up_gradient_sky(toward(0.3), toward(-0.3), torch.zeros(3, dtype=torch.float64))).all()
