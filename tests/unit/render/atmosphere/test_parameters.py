"""Density profiles by hand, and atmospheres that are none."""

import math
from dataclasses import replace

import pytest
import torch

from render.atmosphere.parameters import (
    AtmosphereParameters,
    DensityLayer,
    DensityProfile,
    evaluate_density,
    exponential_profile,
    extinctions_at,
    spectrum_tensor,
    tent_profile,
    uniform_profile,
)
from render.errors import ParameterError
from tests.support.atmospheres import KM, planet, tensor


def test_profiles_by_hand() -> None:
    altitude = tensor(0.0, 10.0 * KM, 25.0 * KM, 40.0 * KM, 60.0 * KM)
    exponential = DensityProfile((DensityLayer(exp_term=1.0, exp_scale=-1.0 / (8.0 * KM)),))
    expected = torch.exp(-altitude / (8.0 * KM))
    torch.testing.assert_close(evaluate_density(exponential, altitude), expected)
    torch.testing.assert_close(evaluate_density(exponential_profile(8.0 * KM), altitude), expected)
    assert not torch.allclose(evaluate_density(exponential_profile(9.0 * KM), altitude), expected)
    affine = DensityProfile((DensityLayer(linear_term=0.02 / KM, constant_term=-0.1),))
    torch.testing.assert_close(evaluate_density(affine, altitude), tensor(0.0, 0.1, 0.4, 0.7, 1.0))
    tent = tensor(0.0, 0.0, 1.0, 0.0, 0.0)
    torch.testing.assert_close(evaluate_density(tent_profile(25.0 * KM, 15.0 * KM), altitude), tent, atol=1e-12, rtol=0)
    torch.testing.assert_close(evaluate_density(uniform_profile(), altitude), torch.ones_like(altitude))


def test_a_layer_begins_at_its_lower_boundary_and_any_number_of_them_stack() -> None:
    layers = tuple(DensityLayer(width=w, constant_term=c) for w, c in ((10.0, 0.1), (20.0, 0.2), (5.0, 0.3)))
    profile = DensityProfile(layers)
    assert profile.boundaries == (10.0, 30.0)
    altitude = tensor(-1.0, 9.999, 10.0, 29.999, 30.0, 1e6)
    torch.testing.assert_close(evaluate_density(profile, altitude), tensor(0.1, 0.1, 0.2, 0.2, 0.3, 0.3))


def test_density_stays_between_zero_and_one_below_the_ground() -> None:
    assert float(evaluate_density(exponential_profile(1.0), tensor(-1e6))) == 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bottom_radius": 2e6}, "end above the ground"),
        ({"bottom_radius": math.nan}, "finite"),
        ({"bottom_radius": -1.0}, "positive"),
        ({"top_radius": math.inf}, "finite"),
        ({"wavelengths": ()}, "numbers for 0 wavelengths"),
        ({"wavelengths": (550e-9, -1.0)}, "wavelengths"),
        ({"solar_irradiance": (1.0,)}, "give one each"),
        ({"solar_irradiance": (1.0, math.nan)}, "finite"),
        ({"rayleigh_scattering": (1e-6, -1e-6)}, "between 0 and inf"),
        ({"mie_extinction": (0.0, 0.0)}, "cannot be smaller"),
        ({"mie_asymmetry": 1.0}, "between -1 and 1"),
        ({"mie_asymmetry": math.nan}, "between -1 and 1"),
        ({"ground_albedo": (0.5, 1.5)}, "between 0 and 1"),
        ({"sun_angular_radius": 0.0}, "sun_angular_radius"),
        ({"min_cos_sun_zenith": 1.0}, "min_cos_sun_zenith"),
    ],
)
def test_what_is_no_atmosphere_is_refused(change: dict, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        replace(planet(), **change)


def test_what_is_no_profile_is_refused() -> None:
    for make in (
        lambda: DensityLayer(width=-1.0),
        lambda: DensityLayer(exp_scale=math.nan),
        lambda: DensityProfile(()),
        lambda: exponential_profile(0.0),
        lambda: tent_profile(10.0, -1.0),
    ):
        with pytest.raises(ParameterError):
            make()


def test_aerosol_is_scaled_and_nothing_else() -> None:
    before = planet()
    after = before.with_aerosol(100.0)
    assert after.mie_scattering == pytest.approx([100.0 * value for value in before.mie_scattering])
    assert after.mie_extinction == pytest.approx([100.0 * value for value in before.mie_extinction])
    restored = replace(after, mie_scattering=before.mie_scattering, mie_extinction=before.mie_extinction)
    assert restored == before
    assert max(before.with_aerosol(0.0).mie_extinction) == 0.0
    for factor in (-1.0, math.inf):
        with pytest.raises(ParameterError, match="aerosol"):
            before.with_aerosol(factor)


def test_coefficients_at_an_altitude_sum_all_kinds() -> None:
    atmosphere = planet(absorption=(1e-6, 3e-6), absorber=uniform_profile())
    rayleigh, mie, extinction = extinctions_at(atmosphere, tensor(0.0, 30.0 * KM))
    e = math.exp
    torch.testing.assert_close(rayleigh[:, 0], tensor(1e-6, 1e-6 * e(-0.5)))
    torch.testing.assert_close(mie[:, 1], tensor(1.1e-6, 1.1e-6 * e(-1.0)))
    torch.testing.assert_close(
        extinction[1], tensor(1e-6, 3e-6) + tensor(1e-6, 2e-6) * e(-0.5) + tensor(2e-6, 1.3e-6) * e(-1.0)
    )


def test_lengths_follow_from_the_radii() -> None:
    atmosphere: AtmosphereParameters = planet()
    assert atmosphere.thickness == 500.0 * KM
    assert atmosphere.horizon_length == pytest.approx(math.sqrt(1500.0**2 - 1000.0**2) * KM)
    assert spectrum_tensor((1.0, 2.0), torch.zeros(1, dtype=torch.float32)).dtype == torch.float32
