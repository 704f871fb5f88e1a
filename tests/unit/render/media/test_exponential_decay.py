import math

import pytest
import torch
from scipy import integrate

from render.media import ExponentialDecay, compute_optical_depth, find_distance
from render.media.sphere import EARTH_RADIUS


def numbers(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_the_profile_falls_by_e_in_a_scale_height() -> None:
    medium = ExponentialDecay(0.04, 50.0, reference=20.0)
    extinction = medium.extinction_at(numbers(20.0, 70.0, -30.0) - medium.datum)
    torch.testing.assert_close(extinction, numbers(0.04, 0.04 / math.e, 0.04 * math.e))
    assert compute_optical_depth(medium, numbers(20.0), 1.0).item() == pytest.approx(2.0)
    assert compute_optical_depth(medium, numbers(20.0), 0.5).item() == pytest.approx(4.0)
    assert compute_optical_depth(medium, numbers(20.0), 0.0).item() == math.inf


def test_fog_without_a_base_thickens_for_ever() -> None:
    medium = ExponentialDecay(0.04, 50.0, base=-math.inf)
    assert compute_optical_depth(medium, numbers(20.0), -0.5).item() == math.inf
    assert compute_optical_depth(medium, numbers(20.0), -1.0, 70.0).item() == pytest.approx(
        2.0 * (math.e - math.exp(-0.4))
    )


def test_the_path_to_the_sun_is_chapman_s() -> None:
    """Against the exact integral over the sphere; 0.1 % at the horizon, and exact overhead."""
    medium = ExponentialDecay(1e-4, 1200.0)

    def exact(slope: float) -> float:
        def density(s: float) -> float:
            r = math.sqrt(EARTH_RADIUS**2 + 2.0 * EARTH_RADIUS * slope * s + s * s)
            return 1e-4 * math.exp(-((2.0 * EARTH_RADIUS * slope * s + s * s) / (r + EARTH_RADIUS)) / 1200.0)

        return sum(integrate.quad(density, a, b, epsrel=1e-11)[0] for a, b in ((0.0, 1e4), (1e4, 1e5), (1e5, 1e6)))

    for slope, tolerance in ((0.0, 1e-3), (0.02, 5e-4), (0.2, 2e-5), (1.0, 1e-9)):
        depth = medium.curved_depth(numbers(0.0), numbers(slope), EARTH_RADIUS).item()
        assert depth == pytest.approx(exact(slope), rel=tolerance)
        flat = compute_optical_depth(medium, numbers(0.0), slope).item()
        assert slope > 0.5 or flat != pytest.approx(exact(slope), rel=tolerance)
    assert medium.curved_depth(numbers(0.0), numbers(-1e-3), EARTH_RADIUS).item() == math.inf
    assert math.isfinite(medium.curved_depth(numbers(1000.0), numbers(-1e-3), EARTH_RADIUS).item())


def test_the_path_to_the_sun_has_gradients_overhead_and_at_the_horizon() -> None:
    for slope in (0.0, 0.01, 0.5, 1.0 - 1e-9):
        l = numbers(slope)[0].requires_grad_()  # noqa: E741
        medium = ExponentialDecay(1e-4, 1200.0, base=-math.inf)
        (gradient,) = torch.autograd.grad(medium.curved_depth(numbers(0.0)[0], l, EARTH_RADIUS), l)
        step = 1e-5 if slope < 0.9 else 1e-10
        ends = [medium.curved_depth(numbers(0.0), numbers(slope + d), EARTH_RADIUS).item() for d in (-step, step)]
        assert gradient.item() == pytest.approx((ends[1] - ends[0]) / (2.0 * step), rel=1e-3 if slope < 0.9 else 2e-2)


@pytest.mark.parametrize("slope", [-0.4, 0.3])
def test_the_sign_of_the_inverse_is_not_the_printed_one(slope: float) -> None:
    """-(H / v) log(1 - y), y = tau v / (sigma H); with the printed sign the distance has another depth."""
    medium, height, depth = ExponentialDecay(0.02, 50.0), numbers(60.0), 0.3
    y = depth * slope / (medium.extinction_at(height).item() * 50.0)
    right, printed = -50.0 / slope * math.log1p(-y), 50.0 / slope * math.log1p(y)
    assert find_distance(medium, height, slope, depth).item() == pytest.approx(right)
    assert compute_optical_depth(medium, height, slope, right).item() == pytest.approx(depth, rel=1e-12)
    assert compute_optical_depth(medium, height, slope, abs(printed)).item() != pytest.approx(depth, rel=1e-2)
