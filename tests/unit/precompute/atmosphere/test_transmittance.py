"""Optical lengths and transmittances against closed forms of exponential, uniform and tent-shaped air, and the reference."""

import math

import numpy as np
import pytest
import torch

from precompute.atmosphere.quadratures import PARITY, LineRule
from precompute.atmosphere.transmittance import (
    build_transmittance,
    compute_optical_length_to_top,
    compute_transmittance_to_top,
)
from render.atmosphere.earth import earth
from render.atmosphere.parameters import DensityProfile, exponential_profile, tent_profile, uniform_profile
from tests.support.atmospheres import KM, SMALL, golden, peak_error, planet, small_states, tensor
from tests.support.atmospheres import PARITY as PARITY_ERROR

RULE = PARITY.transmittance
R = 1200.0 * KM
HEIGHT = 60.0 * KM
LEVEL = math.sqrt(1500.0**2 - 1200.0**2) * KM


@pytest.mark.parametrize(
    ("profile", "cosine", "expected"),
    [
        (exponential_profile(HEIGHT), 1.0, HEIGHT * (math.exp(-200 / 60) - math.exp(-500 / 60))),
        (uniform_profile(), 0.0, LEVEL),
        (uniform_profile(), 1.0, 300.0 * KM),
    ],
)
def test_optical_lengths(profile: DensityProfile, cosine: float, expected: float) -> None:
    found = float(compute_optical_length_to_top(planet(), profile, tensor(R), tensor(cosine), RULE))
    assert found == pytest.approx(expected, abs=1.0)
    assert float(compute_optical_length_to_top(planet(), profile, tensor(R), tensor(0.5), RULE)) != pytest.approx(
        expected, abs=100.0
    )


def test_transmittances_vertically_and_horizontally() -> None:
    def vertical_and_level(atmosphere):
        radius = tensor(atmosphere.bottom_radius, R)
        return compute_transmittance_to_top(atmosphere, radius, tensor(1.0, 0.0), RULE)

    def depth(height: float) -> float:
        return height * (1.0 - math.exp(-500.0 * KM / height))

    found = vertical_and_level(planet())[0]
    expected = [math.exp(-b * depth(60 * KM) - m * depth(30 * KM)) for b, m in ((1e-6, 2e-6), (2e-6, 1.3e-6))]
    torch.testing.assert_close(found, tensor(*expected), atol=1e-3, rtol=0.0)
    assert float((found - tensor(*expected[::-1])).abs().max()) > 1e-3
    tent = planet(absorption=(0.02 / KM, 0.01 / KM), absorber=tent_profile(25 * KM, 15 * KM))
    ratio = vertical_and_level(tent)[0] / found
    torch.testing.assert_close(ratio, torch.exp(tensor(-0.02 * 15.0, -0.01 * 15.0)), atol=1e-3, rtol=0.0)
    even = planet(absorption=(1e-3 / KM, 2e-3 / KM), absorber=uniform_profile())
    ratio = vertical_and_level(even)[1] / vertical_and_level(planet())[1]
    torch.testing.assert_close(ratio, torch.exp(-tensor(1e-6, 2e-6) * LEVEL), atol=1e-3, rtol=0.0)


def test_the_table_of_the_reference() -> None:
    expected = golden("textures_small")["transmittance"]
    assert peak_error(small_states()[0].transmittance, expected) < 1e-12
    coarser = build_transmittance(earth(), SMALL, LineRule("trapezoid", 250))
    assert peak_error(coarser, expected) > PARITY_ERROR


def test_finer_quadrature_meets_the_exact_integral() -> None:
    data = golden("transmittance")
    radius, cosine = torch.from_numpy(data["r_m"]), torch.from_numpy(data["mu"])
    coarse = compute_transmittance_to_top(earth(), radius, cosine, RULE).numpy()
    np.testing.assert_allclose(coarse, data["T_direct500"], atol=1e-12)
    finer = compute_transmittance_to_top(earth(), radius, cosine, LineRule("trapezoid", 8000)).numpy()
    assert np.abs(finer - data["T_exact"]).max() < 2e-7
    assert np.abs(coarse - data["T_exact"]).max() > 1e-6
