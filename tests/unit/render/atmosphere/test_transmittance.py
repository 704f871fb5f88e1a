"""Transmittance looked up: against uniform air, where it is exp(-k d), and against the reference."""

import math

import numpy as np
import pytest
import torch

from precompute.atmosphere.quadratures import PARITY
from precompute.atmosphere.transmittance import build_transmittance, compute_transmittance_to_top
from render.atmosphere.earth import earth
from render.atmosphere.parameters import AtmosphereParameters, uniform_profile
from render.atmosphere.ray_geometry import ray_intersects_ground
from render.atmosphere.tables import TableSizes
from render.atmosphere.transmittance import (
    look_up_transmittance,
    look_up_transmittance_to_sun,
    look_up_transmittance_to_top,
    visible_sun_share,
)
from tests.support.atmospheres import KM, golden, peak_error, planet, small_states, tensor
from tests.support.atmospheres import PARITY as PARITY_ERROR

SIZES = TableSizes(transmittance_radii=64, transmittance_views=256)
R = 1200.0 * KM


def uniform_planet() -> AtmosphereParameters:
    """Air of the same density everywhere, which absorbs only."""
    clear = planet(mie=0.0, absorption=(1e-3 / KM, 5e-4 / KM), absorber=uniform_profile())
    return type(clear)(**{**clear.__dict__, "rayleigh_scattering": (0.0, 0.0)})


def test_the_table_is_the_direct_integral() -> None:
    atmosphere = planet()
    table = build_transmittance(atmosphere, SIZES, PARITY.transmittance)
    radius, cosine = tensor(1400.0 * KM), tensor(0.4)
    direct = compute_transmittance_to_top(atmosphere, radius, cosine, PARITY.transmittance)
    found = look_up_transmittance_to_top(atmosphere, table, radius, cosine)
    torch.testing.assert_close(found, direct, atol=1e-3, rtol=0.0)
    assert not torch.allclose(
        look_up_transmittance_to_top(atmosphere, table, tensor(1100.0 * KM), cosine), direct, atol=1e-3
    )


@pytest.mark.parametrize(
    ("radius", "cosine", "distance"),
    [(1000.0 * KM, 0.0, 300.0 * KM), (R, 0.7, 100.0 * KM), (R, -0.7, 150.0 * KM), (R, -1.0, 200.0 * KM)],
)
def test_segments_of_uniform_air(radius: float, cosine: float, distance: float) -> None:
    atmosphere = uniform_planet()
    table = build_transmittance(atmosphere, SIZES, PARITY.transmittance)
    r, mu, d = tensor(radius), tensor(cosine), tensor(distance)
    found = look_up_transmittance(atmosphere, table, r, mu, d, ray_intersects_ground(atmosphere, r, mu))
    expected = torch.exp(-tensor(*atmosphere.absorption_extinction) * distance)
    torch.testing.assert_close(found, expected, atol=1e-3, rtol=0.0)
    longer = look_up_transmittance(atmosphere, table, r, mu, 0.9 * d, ray_intersects_ground(atmosphere, r, mu))
    assert not torch.allclose(longer, expected, atol=1e-3)


def test_values_of_the_reference() -> None:
    data, table = golden("transmittance"), small_states()[0].transmittance
    r, mu = torch.from_numpy(data["r_m"]), torch.from_numpy(data["mu"])
    found = look_up_transmittance_to_top(earth(), table, r, mu)
    assert peak_error(found, data["T_texture_small"]) < PARITY_ERROR
    assert peak_error(look_up_transmittance_to_top(earth(), table, r, -mu), data["T_texture_small"]) > 0.01
    names = ("seg_r_m", "seg_mu", "seg_d_m", "seg_intersects_ground")
    segment = [torch.from_numpy(data[name]) for name in names]
    assert peak_error(look_up_transmittance(earth(), table, *segment), data["seg_T_texture_small"]) < PARITY_ERROR
    segment[3] = ~segment[3]
    assert peak_error(look_up_transmittance(earth(), table, *segment), data["seg_T_texture_small"]) > 0.01


def test_the_sun_sets_over_its_diameter() -> None:
    atmosphere = earth()
    radius = tensor(atmosphere.bottom_radius + 3000.0)
    dip = math.sqrt(1.0 - (atmosphere.bottom_radius / float(radius)) ** 2)
    horizon, alpha = -math.asin(dip), atmosphere.sun_angular_radius
    elevations = np.array([2.0, 1.01, 0.5, 0.0, -0.5, -1.01]) * alpha + horizon
    share = visible_sun_share(atmosphere, radius, torch.from_numpy(np.sin(elevations)))
    np.testing.assert_allclose(share.numpy(), [1.0, 1.0, 0.84375, 0.5, 0.15625, 0.0], atol=1e-3)
    table = small_states()[0].transmittance
    passing = look_up_transmittance_to_sun(atmosphere, table, radius, torch.from_numpy(np.sin(elevations)))
    top = look_up_transmittance_to_top(atmosphere, table, radius, torch.from_numpy(np.sin(elevations)))
    torch.testing.assert_close(passing, top * share[:, None])
    assert float(passing[-1].abs().max()) == 0.0


def test_air_too_thick_for_floating_point_lets_nothing_through() -> None:
    atmosphere = earth().with_aerosol(1e6)
    table = build_transmittance(atmosphere, TableSizes(16, 32), PARITY.transmittance)
    radius, cosine = tensor(atmosphere.bottom_radius + 10.0), tensor(-0.5, 0.0, 0.5)
    found = look_up_transmittance(
        atmosphere, table, radius, cosine, tensor(15.0), ray_intersects_ground(atmosphere, radius, cosine)
    )
    assert bool(((found >= 0.0) & (found <= 1.0)).all())
