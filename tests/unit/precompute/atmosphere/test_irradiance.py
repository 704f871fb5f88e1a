"""Irradiance: a uniform sky gives pi, the setting sun half of itself, and the tables of the reference."""

import math

import pytest
import torch

from precompute.atmosphere.irradiance import compute_direct_irradiance, compute_indirect_irradiance
from precompute.atmosphere.quadratures import PARITY, DirectionRule, LineRule
from precompute.atmosphere.scattering_density import ScatteredOrder
from render.atmosphere.tables import TableSizes
from tests.support.atmospheres import KM, golden, peak_error, planet, small_states, tensor
from tests.support.atmospheres import PARITY as PARITY_ERROR

SIZES = TableSizes(8, 16, 4, 16, 4, 8, 4, 8)
BOTTOM = tensor(1000.0 * KM)


def test_a_uniform_sky_gives_pi() -> None:
    order = ScatteredOrder((torch.ones(*SIZES.scattering, 2, dtype=torch.float64),), 0.0)
    found = compute_indirect_irradiance(planet(), order, BOTTOM, tensor(1.0, 0.2, -0.5), PARITY.irradiance)
    torch.testing.assert_close(found, torch.full((3, 2), math.pi, dtype=torch.float64), atol=1e-2, rtol=0.0)
    finer = DirectionRule(LineRule("gauss_legendre", 16), LineRule("midpoint", 4))
    found = compute_indirect_irradiance(planet(), order, BOTTOM, tensor(0.2), finer)
    torch.testing.assert_close(found, torch.full((2,), math.pi, dtype=torch.float64))
    assert float(found[0]) != pytest.approx(2.0 * math.pi, abs=1.0)


def test_the_sky_above_a_raised_surface_is_that_without_ground() -> None:
    """Half of the views of the table are ground: were they looked up, the sky would not be uniform."""
    table = torch.ones(*SIZES.scattering, 2, dtype=torch.float64)
    table[:, : SIZES.views // 2] = 100.0
    order = ScatteredOrder((table,), 0.0)
    found = compute_indirect_irradiance(planet(), order, tensor(1300.0 * KM), tensor(0.3), PARITY.irradiance)
    assert float(found[0]) == pytest.approx(math.pi, abs=1e-2)


def test_the_sun_is_dimmed_as_it_sets() -> None:
    atmosphere, alpha = planet(), planet().sun_angular_radius
    clear = torch.ones(8, 16, 2, dtype=torch.float64)
    cosines = tensor(1.0, 0.3, alpha, 0.0, -alpha, -0.5)
    found = compute_direct_irradiance(atmosphere, clear, BOTTOM, cosines)[:, 0] / 123.0
    torch.testing.assert_close(found, tensor(1.0, 0.3, alpha, alpha / 4.0, 0.0, 0.0))


def test_the_tables_of_the_reference() -> None:
    data, states = golden("textures_small"), small_states()
    for order in range(4):
        expected = data[f"delta_irradiance_{order}"]
        assert peak_error(states[order].ground_irradiance, expected) < PARITY_ERROR
        assert peak_error(states[order].ground_irradiance, data[f"delta_irradiance_{(order + 1) % 4}"]) > 0.1
    for order in (2, 3, 4):
        expected = data[f"irradiance_sum_init{order}"]
        assert peak_error(states[order - 1].irradiance, expected) < PARITY_ERROR
        assert peak_error(states[order - 2].irradiance, expected) > 1e-3
