import pytest
import torch

from render.media import LinearDecay, compute_optical_depth
from render.media.sphere import EARTH_RADIUS, curvature


def numbers(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_the_profile_is_a_line_from_base_to_top() -> None:
    medium = LinearDecay(0.04, top=110.0, base=10.0)
    extinction = medium.extinction_at(numbers(10.0, 60.0, 85.0, 110.0) - medium.datum)
    torch.testing.assert_close(extinction, numbers(0.04, 0.02, 0.01, 0.0))
    assert compute_optical_depth(medium, numbers(500.0), -1.0).item() == pytest.approx(2.0)
    assert compute_optical_depth(medium, numbers(500.0), -1.0, 440.0).item() == pytest.approx(0.5)


def test_a_ray_from_the_very_top_keeps_its_digits() -> None:
    """s = 1e-9 m below the top the depth is G s^2 / 2; told from sea level, s would have six digits."""
    medium = LinearDecay(0.04, top=1000.0)
    depth = compute_optical_depth(medium, numbers(1000.0), -1.0, 1.1e-9).item()
    assert depth == pytest.approx(0.5 * 0.04 / 1000.0 * 1.1e-9**2, rel=1e-12, abs=0.0)


def test_the_path_to_a_low_sun_is_the_integral_over_the_parabola() -> None:
    medium = LinearDecay(1e-4, 1000.0)
    for slope in (-0.005, 0.0, 0.01, 0.3, 1.0):
        kappa = curvature(numbers(slope), EARTH_RADIUS).item()
        level = -300.0
        s = torch.linspace(0.0, 3e5, 400_001, dtype=torch.float64)
        height = level + slope * s + 0.5 * kappa * s**2
        first_exit = int(torch.nonzero((height > 0.0) & (s > 0.0))[0])
        density = torch.where(torch.arange(len(s)) < first_exit, medium.extinction_at(height), 0.0)
        expected = torch.trapezoid(density, s).item()
        depth = medium.curved_depth(numbers(level), numbers(slope), EARTH_RADIUS).item()
        assert depth == pytest.approx(expected, rel=1e-5)
        assert (
            medium.curved_depth(numbers(level), numbers(slope + 0.002), EARTH_RADIUS).item()
            != pytest.approx(expected, rel=1e-5)
            or slope == 1.0
        )
