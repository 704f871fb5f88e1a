"""Light of later orders: uniform sources through clear air, tables against the plain integral, and the reference."""

import pytest
import torch

from precompute.atmosphere.multiple_scattering import build_multiple_scattering, compute_multiple_scattering
from precompute.atmosphere.quadratures import PARITY, LineRule
from render.atmosphere.air_ray import AirRay
from render.atmosphere.earth import earth
from render.atmosphere.tables import TableSizes, look_up_scattering, scattering_nodes
from tests.support.atmospheres import KM, SMALL, golden, just_below_horizon, peak_error, planet, ray, small_states
from tests.support.atmospheres import PARITY as PARITY_ERROR

SIZES = TableSizes(8, 16, 4, 16, 8, 16, 4, 8)
RULE = PARITY.multiple_scattering
TOP = 1500.0 * KM


@pytest.mark.parametrize("view", [-1.0, just_below_horizon(planet(), TOP)])
def test_a_uniform_source_through_clear_air_grows_with_the_distance(view: float) -> None:
    atmosphere = planet()
    transmittance = torch.ones(8, 16, 2, dtype=torch.float64)
    source = torch.full((*SIZES.scattering, 2), 3e-5, dtype=torch.float64)
    one = ray(atmosphere, TOP, view, 0.4, 0.4 * view)
    expected = 3e-5 * one.length(atmosphere).expand(2)
    plain = compute_multiple_scattering(atmosphere, transmittance, source, one, RULE)
    rows = [
        build_multiple_scattering(atmosphere, SIZES, transmittance, source, node, RULE) for node in range(SIZES.radii)
    ]
    for found in (plain, look_up_scattering(atmosphere, torch.stack(rows), one)):
        torch.testing.assert_close(found, expected, rtol=1e-3, atol=0.0)
    denied = AirRay(*one.tensors()[:4], torch.tensor(False))
    beyond = compute_multiple_scattering(atmosphere, transmittance, source, denied, RULE)
    assert not torch.allclose(beyond, expected, rtol=1e-2)


@pytest.mark.parametrize("node", [0, 4])
def test_the_table_is_the_plain_integral(node: int) -> None:
    """The source is noise, so that any interpolation at a wrong place shows."""
    transmittance = small_states()[0].transmittance
    generator = torch.Generator().manual_seed(7)
    source = torch.rand(*SMALL.scattering, 3, generator=generator, dtype=torch.float64)
    built = build_multiple_scattering(earth(), SMALL, transmittance, source, node, RULE)
    rays = scattering_nodes(earth(), SMALL, node)
    plain = compute_multiple_scattering(earth(), transmittance, source, rays, RULE)
    torch.testing.assert_close(built, plain, rtol=1e-10, atol=1e-12 * float(plain.max()))
    fewer = compute_multiple_scattering(earth(), transmittance, source, rays, LineRule("trapezoid", 25))
    assert not torch.allclose(built, fewer, rtol=1e-3)


def test_the_tables_of_the_reference() -> None:
    data = golden("textures_small")
    for order in (2, 3, 4):
        expected = data[f"delta_multiple_{order}"]
        found = small_states()[order - 1].light[0].reshape(expected.shape)
        assert peak_error(found, expected) < PARITY_ERROR
        assert peak_error(found, data[f"delta_multiple_{2 + order % 3}"]) > 0.1
