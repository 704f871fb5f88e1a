"""The scattering density where theory knows it: uniform light, and light from the ground alone."""

import math

import pytest
import torch

from precompute.atmosphere.density_table import build_scattering_density
from precompute.atmosphere.quadratures import PARITY, DirectionRule, LineRule
from precompute.atmosphere.scattering_density import (
    GroundReflection,
    ScatteredOrder,
    compute_scattering_density,
    sun_direction,
)
from render.atmosphere.air_ray import AirRay
from render.atmosphere.tables import TableSizes, look_up_scattering
from tests.support.atmospheres import KM, planet, ray, tensor

SIZES = TableSizes(8, 16, 4, 16, 4, 8, 4, 8)
RULE = PARITY.scattering_density
BOTTOM = 1000.0 * KM

VIEWS = [(0.3, 2e-3), (1.0, 3e-3), (-1.0, 3e-3)]
"""The midpoints miss 0.24 % of the phase function of a vertical ray, less elsewhere."""


def constant(value: float, shape: tuple[int, ...]) -> torch.Tensor:
    return torch.full((*shape, 2), value, dtype=torch.float64)


def density_of(
    atmosphere, light: float, irradiance: float, one: AirRay, rule: DirectionRule = RULE
) -> list[torch.Tensor]:
    """By the plain sum, and looked up in the table of the first radius (there the ground is at hand and air is densest)."""
    transmittance = constant(1.0, (8, 16))
    before = ScatteredOrder((constant(light, SIZES.scattering),), atmosphere.mie_asymmetry)
    ground = constant(irradiance, (4, 16))
    plain = compute_scattering_density(atmosphere, transmittance, before, ground, one, rule)
    rows = [
        build_scattering_density(atmosphere, SIZES, transmittance, before, ground, node, rule) for node in (0, 1, 2, 3)
    ]
    return [plain, look_up_scattering(atmosphere, torch.stack(rows), one)]


def total_scattering(atmosphere) -> torch.Tensor:
    return tensor(*atmosphere.rayleigh_scattering) + tensor(*atmosphere.mie_scattering)


@pytest.mark.parametrize(("view", "tolerance"), VIEWS)
def test_uniform_light_is_scattered_whole(view: float, tolerance: float) -> None:
    atmosphere = planet(ground_albedo=0.0)
    for found in density_of(atmosphere, 13.0, 99.0, ray(atmosphere, BOTTOM, view, 0.4, 0.4 * view)):
        torch.testing.assert_close(found, 13.0 * total_scattering(atmosphere), rtol=tolerance, atol=0.0)
        assert not torch.allclose(found, 13.0 * total_scattering(atmosphere).flip(0), rtol=2e-3, atol=0.0)


@pytest.mark.parametrize(("view", "tolerance"), VIEWS)
def test_light_of_the_ground_alone(view: float, tolerance: float) -> None:
    """From the lower half of all directions comes albedo E / pi; an even phase function scatters half of it anywhere."""
    atmosphere = planet(ground_albedo=0.6)
    expected = total_scattering(atmosphere) * tensor(0.6, 0.3) * 5.0 / (2.0 * math.pi)
    for found in density_of(atmosphere, 0.0, 5.0, ray(atmosphere, BOTTOM, view, 0.4, 0.4 * view)):
        torch.testing.assert_close(found, expected, rtol=tolerance, atol=0.0)
        assert not torch.allclose(found, 2.0 * expected, rtol=2e-3, atol=0.0)


def test_the_grid_of_directions_misses_part_of_a_narrow_lobe() -> None:
    """With g = 0.8 the reference's 16 x 32 directions hold 0.996 to 1.054 of the lobe; finer ones hold all of it."""
    atmosphere = planet(asymmetry=0.8, ground_albedo=0.0)
    share = [
        float(
            (
                density_of(atmosphere, 1.0, 0.0, ray(atmosphere, BOTTOM, view, 0.4, 0.4 * view))[0]
                / total_scattering(atmosphere)
            )[0]
        )
        for view in (1.0, 0.0)
    ]
    assert max(abs(value - 1.0) for value in share) > 2e-3
    fine = DirectionRule(LineRule("midpoint", 64), LineRule("midpoint", 4))
    found = compute_scattering_density(
        atmosphere,
        constant(1.0, (8, 16)),
        ScatteredOrder((constant(1.0, SIZES.scattering),), 0.8),
        constant(0.0, (4, 16)),
        ray(atmosphere, BOTTOM, 1.0, 0.4, 0.4),
        fine,
    )
    torch.testing.assert_close(found, total_scattering(atmosphere), rtol=2e-3, atol=0.0)


def test_the_sun_stands_where_the_angles_say() -> None:
    rays = AirRay.towards(planet(), tensor(BOTTOM), tensor(0.6), tensor(0.5), tensor(0.7, 0.3, 0.1))
    x, y = sun_direction(rays)
    torch.testing.assert_close(0.8 * x + 0.6 * 0.5, rays.cos_view_sun)
    torch.testing.assert_close(x * x + y * y + 0.25, torch.ones(3, dtype=torch.float64))
    vertical = AirRay.towards(planet(), tensor(BOTTOM), tensor(1.0), tensor(0.5), tensor(0.5))
    assert float(sun_direction(vertical)[0]) == 0.0


def test_ground_seen_from_above() -> None:
    atmosphere = planet(ground_albedo=0.5)
    table = constant(1.0, (8, 16))
    seen = GroundReflection.seen(atmosphere, table, tensor(BOTTOM + 100 * KM), tensor(-1.0, 0.5))
    assert seen.intersects_ground.tolist() == [True, False]
    assert seen.distance.tolist() == [100 * KM, 0.0]
    torch.testing.assert_close(seen.factor, torch.stack([tensor(0.5, 0.25) / math.pi, tensor(0.0, 0.0)]))
    assert float(seen.cos_sun(tensor(0.3), tensor(-0.3, 0.0))[0]) == pytest.approx(0.3)


def test_an_order_has_one_table_or_two() -> None:
    with pytest.raises(ValueError, match="two tables"):
        ScatteredOrder((), 0.0)
    assert ScatteredOrder((torch.zeros(1),), 0.0).phase_factors(tensor(0.1)) == (None,)
    rayleigh, mie = ScatteredOrder((torch.zeros(1),) * 2, 0.8).phase_factors(tensor(1.0))
    assert float(mie) > 10.0 * float(rayleigh)
