"""Light scattered once against closed forms, tables against direct integrals, and the reference."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from precompute.atmosphere.quadratures import PARITY, LineRule
from precompute.atmosphere.single_scattering import build_single_scattering, compute_single_scattering
from precompute.atmosphere.transmittance import build_transmittance
from render.atmosphere.air_ray import AirRay
from render.atmosphere.earth import earth
from render.atmosphere.parameters import AtmosphereParameters, uniform_profile
from render.atmosphere.ray_geometry import ray_intersects_ground
from render.atmosphere.tables import TableSizes, look_up_scattering, scattering_nodes
from tests.support.atmospheres import (
    KM,
    SMALL,
    golden,
    just_below_horizon,
    peak_error,
    planet,
    ray,
    small_states,
)
from tests.support.atmospheres import PARITY as PARITY_ERROR

SIZES = TableSizes(64, 256, 4, 16, 16, 32, 4, 16)
RULE = PARITY.single_scattering
BOTTOM, TOP = 1000.0 * KM, 1500.0 * KM


def depth(height: float, low: float = 0.0, high: float = 500.0 * KM) -> float:
    """Column of exponential air between two altitudes [m]."""
    return height * (math.exp(-low / height) - math.exp(-high / height))


def integrand(
    atmosphere: AtmosphereParameters, radius: float, view: float, sun: float, nu: float
) -> tuple[float, float]:
    """Transmittance to the sun and back times density, of air and of aerosols, in the middle of a ray; first wavelength."""
    table = build_transmittance(atmosphere, SIZES, PARITY.transmittance)
    one = ray(atmosphere, radius, view, sun, nu)
    length = float(one.length(atmosphere))
    found = compute_single_scattering(atmosphere, table, one, LineRule("midpoint", 1))
    scattering = atmosphere.rayleigh_scattering[0], atmosphere.mie_scattering[0]
    return tuple(
        float(f[0]) / (length * s * atmosphere.solar_irradiance[0]) for f, s in zip(found, scattering, strict=True)
    )


def test_the_integrand_up_down_and_along() -> None:
    air, aerosol = planet(), planet(mie=1.0)
    middle = 250.0 * KM
    column = 1e-6 * depth(60 * KM) + 2e-6 * depth(30 * KM)
    found = integrand(air, BOTTOM, 1.0, 1.0, 1.0)
    for value, height in zip(found, (60 * KM, 30 * KM), strict=True):
        assert value == pytest.approx(math.exp(-column) * math.exp(-middle / height), abs=1e-3)
    above = 1e-6 * depth(60 * KM, middle) + 2e-6 * depth(30 * KM, middle)
    down = integrand(aerosol, TOP, -1.0, 1.0, -1.0)
    assert down[0] == pytest.approx(math.exp(-2.0 * above) * math.exp(-middle / (60 * KM)), abs=1e-3)
    assert found[0] != pytest.approx(down[0], abs=1e-3)
    even = replace(planet(), rayleigh_density=uniform_profile(), mie_density=uniform_profile())
    level = math.sqrt(1500.0**2 - 1200.0**2) * KM
    along = integrand(even, 1200.0 * KM, 0.0, 0.0, 1.0)
    assert along == pytest.approx([math.exp(-3e-6 * level)] * 2, abs=1e-3)
    assert integrand(even, 1200.0 * KM, 0.0, 0.5, math.sqrt(0.75)) != pytest.approx(along, abs=1e-2)


def test_rays_to_the_zenith_and_the_nadir_have_closed_forms() -> None:
    atmosphere = planet()
    table = build_transmittance(atmosphere, SIZES, PARITY.transmittance)
    up = compute_single_scattering(atmosphere, table, ray(atmosphere, BOTTOM, 1.0, 1.0, 1.0), RULE)
    column = math.exp(-1e-6 * depth(60 * KM) - 2e-6 * depth(30 * KM))
    assert float(up[0][0]) == pytest.approx(123.0 * 1e-6 * depth(60 * KM) * column, rel=1e-2)
    assert float(up[1][0]) == pytest.approx(123.0 * 1.5e-6 * depth(30 * KM) * column, rel=5e-2)
    clear = planet(mie=0.0)
    table = build_transmittance(clear, SIZES, PARITY.transmittance)
    for nu, agrees in ((-1.0, True), (-0.2, False)):
        down = compute_single_scattering(clear, table, ray(clear, TOP, -1.0, -nu, nu), RULE)
        expected = 123.0 * 0.5 * (1.0 - math.exp(-2.0 * 1e-6 * depth(60 * KM)))
        assert (float(down[0][0]) == pytest.approx(expected, rel=2e-3)) is agrees
        assert float(down[1].abs().max()) == 0.0


@pytest.mark.parametrize(
    ("radius", "view", "sun", "nu", "tolerance"),
    [
        (BOTTOM, 1.0, 1.0, 1.0, 1e-3),
        (TOP, -1.0, 1.0, -1.0, 1e-3),
        (TOP, just_below_horizon(planet(), TOP, -1e-4), 1.0, just_below_horizon(planet(), TOP, -1e-4), 1e-3),
        (TOP, just_below_horizon(planet(), TOP, 1e-4), 0.9, 0.1, 1e-1),
        (BOTTOM, 0.0, 0.0, 1.0, 1e-1),
    ],
)
def test_looked_up_light_is_the_direct_integral(
    radius: float, view: float, sun: float, nu: float, tolerance: float
) -> None:
    atmosphere = planet()
    table = build_transmittance(atmosphere, SIZES, PARITY.transmittance)
    found = [build_single_scattering(atmosphere, SIZES, table, node, RULE) for node in range(SIZES.radii)]
    one = ray(atmosphere, radius, view, sun, nu)
    direct = compute_single_scattering(atmosphere, table, one, RULE)
    for kind in (0, 1):
        light = look_up_scattering(atmosphere, torch.stack([pair[kind] for pair in found]), one)
        torch.testing.assert_close(light, direct[kind], rtol=tolerance, atol=1e-6)
        assert not torch.allclose(0.8 * light, direct[kind], rtol=tolerance, atol=1e-6)


def test_the_table_is_the_plain_integral_at_every_node() -> None:
    table = small_states()[0].transmittance
    for node in (0, 5):
        built = build_single_scattering(earth(), SMALL, table, node, RULE)
        plain = compute_single_scattering(earth(), table, scattering_nodes(earth(), SMALL, node), RULE)
        for one, other in zip(built, plain, strict=True):
            torch.testing.assert_close(one, other, rtol=1e-11, atol=1e-13)
        assert not torch.allclose(built[0], plain[1], rtol=0.1)


def test_the_tables_of_the_reference() -> None:
    data, state = golden("textures_small"), small_states()[0]
    for table, name in zip(state.light, ("delta_rayleigh", "delta_mie"), strict=True):
        assert peak_error(table.reshape(data[name].shape), data[name]) < PARITY_ERROR
    assert peak_error(state.light[1].reshape(data["delta_mie"].shape), data["delta_rayleigh"]) > 0.1


def test_direct_integrals_of_the_reference() -> None:
    """With its own transmittance, default size, the reference's integral of fifty steps; more steps come nearer to the exact one."""
    data = golden("sky_radiance")
    table = torch.from_numpy(golden("textures_full_samples")["transmittance"])
    rows = np.arange(0, len(data["r_m"]), 7)
    members = [torch.from_numpy(data[name][rows]) for name in ("r_m", "mu", "mu_s", "nu", "intersects_ground")]
    rays = AirRay(*members)
    assert bool((ray_intersects_ground(earth(), rays.radius, rays.cos_view) == rays.intersects_ground).all())
    coarse = compute_single_scattering(earth(), table, rays, RULE)
    fine = compute_single_scattering(earth(), table, rays, LineRule("trapezoid", 1000))
    for number, name in enumerate(("rayleigh", "mie")):
        assert peak_error(coarse[number], data[f"single_{name}_direct50"][rows]) < PARITY_ERROR
        exact = data[f"single_{name}_exact"][rows]
        high = data["sun_zenith_deg"][rows] <= 80.0
        errors = [np.abs(found[number].numpy() - exact)[high].max() / exact.max() for found in (coarse, fine)]
        assert errors[1] < 0.3 * errors[0]
