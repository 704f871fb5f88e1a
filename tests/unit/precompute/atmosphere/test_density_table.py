"""The table of the scattering density: the plain sum over directions, at every node, and the reference."""

import pytest
import torch

from precompute.atmosphere.density_table import build_scattering_density
from precompute.atmosphere.quadratures import PARITY, DirectionRule, LineRule
from precompute.atmosphere.scattering_density import ScatteredOrder, compute_scattering_density
from render.atmosphere.tables import TableSizes, scattering_nodes
from tests.support.atmospheres import PARITY as PARITY_ERROR
from tests.support.atmospheres import golden, peak_error, planet, small_states

SIZES = TableSizes(8, 16, 4, 24, 3, 6, 5, 4)


def random_table(*shape: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(*shape, 2, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("tables", [1, 2])
@pytest.mark.parametrize("node", [0, 1, 2])
def test_the_table_is_the_plain_sum(tables: int, node: int) -> None:
    """Light that is noise, so that any interpolation at a wrong place shows; a planet with a wide horizon and a coarse grid."""
    atmosphere = planet(asymmetry=0.6, ground_albedo=0.7)
    rule = DirectionRule(LineRule("midpoint", 7), LineRule("midpoint", 5))
    transmittance = random_table(8, 16, seed=1)
    light = tuple(random_table(*SIZES.scattering, seed=2 + number) for number in range(tables))
    before = ScatteredOrder(light, atmosphere.mie_asymmetry)
    ground = 30.0 * random_table(4, 24, seed=9)
    rays = scattering_nodes(atmosphere, SIZES, node)
    built = build_scattering_density(atmosphere, SIZES, transmittance, before, ground, node, rule)
    plain = compute_scattering_density(atmosphere, transmittance, before, ground, rays, rule)
    torch.testing.assert_close(built, plain, rtol=1e-9, atol=1e-9 * float(plain.max()))
    other = compute_scattering_density(atmosphere, transmittance, before, ground.flip(1), rays, rule)
    assert not torch.allclose(built, other, rtol=1e-3, atol=0.0)


def test_the_tables_of_the_reference() -> None:
    data = golden("textures_small")
    for order in (2, 3, 4):
        expected = data[f"scattering_density_{order}"]
        found = small_states()[order - 1].density
        assert found is not None
        assert peak_error(found.reshape(expected.shape), expected) < PARITY_ERROR
        assert peak_error(found.reshape(expected.shape), data[f"scattering_density_{2 + order % 3}"]) > 0.1
    assert PARITY.scattering_density.polar.count == 16
