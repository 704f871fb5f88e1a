"""The Earth preset: the parameters of the reference, at its wavelengths and between them."""

import json
import math

import numpy as np
import pytest

from render.atmosphere.earth import OZONE_CROSS_SECTION, SAMPLED_WAVELENGTHS, SOLAR_IRRADIANCE, earth
from render.errors import ParameterError
from tests.support.shared_data import shared_file

NAMES = {
    "solar_irradiance": "solar_irradiance_W_m2_nm",
    "rayleigh_scattering": "rayleigh_scattering_1_m",
    "mie_scattering": "mie_scattering_1_m",
    "mie_extinction": "mie_extinction_1_m",
    "absorption_extinction": "absorption_extinction_1_m",
    "ground_albedo": "ground_albedo",
    "sun_angular_radius": "sun_angular_radius_rad",
    "min_cos_sun_zenith": "mu_s_min",
    "bottom_radius": "bottom_radius_m",
    "top_radius": "top_radius_m",
    "mie_asymmetry": "mie_phase_function_g",
}


def test_the_default_is_the_planet_of_the_reference() -> None:
    expected = json.loads(shared_file("golden/bruneton/params.json").read_text())
    for name, key in NAMES.items():
        np.testing.assert_allclose(getattr(earth(), name), expected[key], rtol=1e-15, err_msg=name)
    layers = expected["density_profiles"]
    for name, key in (("rayleigh_density", "rayleigh"), ("mie_density", "mie"), ("absorption_density", "ozone")):
        profile = getattr(earth(), name).layers
        top = [profile[-1].exp_term, profile[-1].exp_scale, profile[-1].linear_term, profile[-1].constant_term]
        np.testing.assert_allclose(top, layers[key][1][1:], rtol=1e-15)
    assert earth().absorption_density.boundaries == (25_000.0,)
    assert tuple(expected["solar_irradiance_table_360_830_step10"]) == SOLAR_IRRADIANCE
    assert tuple(expected["ozone_cross_section_table_m2_360_830_step10"]) == OZONE_CROSS_SECTION


def test_where_the_scattering_of_molecules_is_from() -> None:
    """The formula that the constant's comment names, and the table that it does not agree with (Penndorf 1957, table 3)."""
    index, molecules, depolarisation = 1.0003, 2.545e25, 0.035
    king = (6.0 + 3.0 * depolarisation) / (6.0 - 7.0 * depolarisation)
    strength = 8.0 * math.pi**3 * (index**2 - 1.0) ** 2 / (3.0 * molecules) * king
    wavelengths = np.array([440e-9, 550e-9, 680e-9])
    ours = np.array(earth(tuple(wavelengths)).rayleigh_scattering)
    np.testing.assert_allclose(ours, strength / wavelengths**4, rtol=5e-4)
    assert not np.allclose(ours, strength / king / wavelengths**4, rtol=0.05)
    measured = ours / np.array([30.60e-6, 12.26e-6, 5.178e-6])
    assert bool(((measured > 1.08) & (measured < 1.125)).all())


def test_any_wavelengths_in_any_order() -> None:
    forwards, backwards = earth((440e-9, 680e-9)), earth((680e-9, 440e-9))
    assert forwards.rayleigh_scattering == backwards.rayleigh_scattering[::-1]
    assert forwards.rayleigh_scattering[0] / forwards.rayleigh_scattering[1] == pytest.approx((680 / 440) ** 4)
    many = earth([1e-9 * value for value in SAMPLED_WAVELENGTHS])
    assert many.solar_irradiance == SOLAR_IRRADIANCE
    halfway = earth((555e-9,))
    assert halfway.solar_irradiance[0] == pytest.approx(0.5 * (1.8504 + 1.8341))


@pytest.mark.parametrize("wavelength", [359e-9, 831e-9, 550.0, float("nan")])
def test_wavelengths_outside_the_spectra_are_refused(wavelength: float) -> None:
    with pytest.raises(ParameterError, match="360e-9 to 830e-9"):
        earth((550e-9, wavelength))


def test_another_ground() -> None:
    assert earth(ground_albedo=0.8).ground_albedo == (0.8, 0.8, 0.8)
    with pytest.raises(ParameterError, match="ground_albedo"):
        earth(ground_albedo=1.2)
