"""Single scattering against closed forms and the golden integrals."""

import math

import numpy as np
import pytest

from render.atmosphere.earth import earth
from render.atmosphere.shells import cut_into_shells
from render.atmosphere.single_scattering import compute_single_radiance, compute_single_scattering
from render.errors import ParameterError
from tests.support.planets import golden, golden_rays, one_ray, uniform_air


def test_closed_forms_of_uniform_air() -> None:
    planet = uniform_air(1e-5, extinction=1.5e-5)
    shells, depth, solar = cut_into_shells(planet), 1.5e-5 * 60_000.0, planet.solar_irradiance[0]
    up = one_ray(planet.bottom_radius, 1.0, 1.0, 1.0)
    down = one_ray(planet.top_radius, -1.0, 1.0, -1.0, ground=True)
    away = solar * 1e-5 * 60_000.0 * math.exp(-depth)
    towards = solar * 1e-5 / (2.0 * 1.5e-5) * -math.expm1(-2.0 * depth)
    for ray, exact in ((up, away), (down, towards)):
        molecules, aerosols = compute_single_scattering(shells, ray)
        assert float(molecules) == 0.0
        assert float(aerosols) == pytest.approx(exact, rel=1e-9)
        assert float(aerosols) != pytest.approx(1.001 * exact, rel=1e-4)
        radiance = compute_single_radiance(shells, ray)
        assert float(radiance) == pytest.approx(exact * 3.0 / (8.0 * math.pi), rel=1e-9)


@pytest.mark.parametrize("zenith_deg", [0.0, 60.0, 88.0, 92.0])
def test_it_is_the_golden_integral(zenith_deg: float) -> None:
    rows = golden("sky_radiance")
    chosen = np.flatnonzero(rows["sun_zenith_deg"] == zenith_deg)[::6]
    found = compute_single_radiance(cut_into_shells(earth()), golden_rays(rows, chosen)).numpy()
    exact = rows["L_order1_exact"][chosen]
    scale = exact.max()
    assert np.abs(found - exact).max() < 3e-6 * scale
    assert np.abs(found - rows["L_order1_direct50"][chosen]).max() > 3e-6 * scale


def test_a_looser_tolerance_is_less_exact_and_none_is_refused() -> None:
    planet = earth()
    shells = cut_into_shells(planet)
    ray = one_ray(planet.bottom_radius + 1000.0, 0.02, -0.02, 0.9)  # through the edge of the planet's shadow
    truth = compute_single_radiance(shells, ray, 1e-10)
    loose = (compute_single_radiance(shells, ray, 0.5) / truth - 1.0).abs().max()
    tight = (compute_single_radiance(shells, ray, 1e-6) / truth - 1.0).abs().max()
    assert float(tight) < 1e-6 < float(loose)
    with pytest.raises(ParameterError, match="tolerance"):
        compute_single_scattering(shells, ray, 0.0)
