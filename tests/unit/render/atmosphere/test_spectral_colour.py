"""Colours of spectra: the integrals of the colour-matching functions, known lights, and spectra of 47 wavelengths."""

import numpy as np
import pytest
import torch

from render.atmosphere.earth import DEFAULT_WAVELENGTHS, SAMPLED_WAVELENGTHS, SOLAR_IRRADIANCE
from render.atmosphere.spectral_colour import (
    COLOUR_MATCHING,
    LUMINOUS_EFFICACY,
    SRGB_FROM_XYZ,
    convert_to_linear_srgb,
    convert_to_luminance,
    convert_to_xyz,
)
from render.errors import ParameterError
from tests.support.atmospheres import golden

ALL = tuple(1e-9 * value for value in SAMPLED_WAVELENGTHS)


def test_colour_matching_functions_have_the_integrals_of_the_standard() -> None:
    """Integrals of the table in steps of 1 nm: 106.865, 106.857, 106.892 nm."""
    integrals = 10.0 * np.array(COLOUR_MATCHING).sum(0)
    np.testing.assert_allclose(integrals, [106.865, 106.857, 106.892], rtol=1e-3)
    x, y, _ = np.array(COLOUR_MATCHING).T
    assert SAMPLED_WAVELENGTHS[int(y.argmax())] in (550.0, 560.0)
    assert SAMPLED_WAVELENGTHS[int(x.argmax())] == 600.0


def test_an_equal_energy_spectrum_is_neutral() -> None:
    """The functions are normalised so: x = y = z = 1/3. In steps of 10 nm that is kept to 4e-4."""
    x, y, z = np.array(COLOUR_MATCHING).sum(0)
    np.testing.assert_allclose([x / y, z / y], [1.0, 1.0], rtol=1e-3)
    rows = dict(zip(SAMPLED_WAVELENGTHS, COLOUR_MATCHING, strict=True))
    assert rows[550.0] == (0.4334499, 0.9949501, 0.008749999)
    assert rows[780.0] == (4.150994e-05, 1.499e-05, 0.0)


def test_the_sun_has_its_illuminance_and_colour() -> None:
    """Above the air: about 134 klx, and a chromaticity near (0.323, 0.333), a black body of 5900 K."""
    sun = torch.tensor(SOLAR_IRRADIANCE, dtype=torch.float64)
    assert float(convert_to_luminance(sun, ALL)) == pytest.approx(134e3, rel=0.02)
    xyz = convert_to_xyz(sun, ALL)
    assert (xyz[:2] / xyz.sum()).tolist() == pytest.approx([0.323, 0.333], abs=0.004)
    three = torch.tensor([1.474, 1.8504, 1.91198], dtype=torch.float64)
    assert float(convert_to_luminance(three, DEFAULT_WAVELENGTHS)) == pytest.approx(134e3, rel=0.06)


def test_red_is_red_and_the_order_of_wavelengths_does_not_matter() -> None:
    red = convert_to_linear_srgb(torch.tensor([1.0, 0.0, 0.0]), DEFAULT_WAVELENGTHS)
    blue = convert_to_linear_srgb(torch.tensor([0.0, 0.0, 1.0]), DEFAULT_WAVELENGTHS)
    assert int(red.argmax()) == 0
    assert int(blue.argmax()) == 2
    turned = convert_to_linear_srgb(torch.tensor([0.0, 0.0, 1.0]), DEFAULT_WAVELENGTHS[::-1])
    torch.testing.assert_close(turned, red)
    assert red.dtype == torch.float32


def test_white_is_white() -> None:
    white = np.linalg.solve(np.array(SRGB_FROM_XYZ), np.ones(3))
    np.testing.assert_allclose(white / white[1], [0.9505, 1.0, 1.0890], atol=2e-4)
    assert LUMINOUS_EFFICACY == 683.0


@pytest.mark.parametrize(
    ("nodes", "median", "largest"), [((440, 550, 680), 0.04, 0.3), (tuple(range(400, 701, 50)), 0.012, 0.025)]
)
def test_few_wavelengths_give_the_colour_of_many_to_the_stated_error(
    nodes: tuple[int, ...], median: float, largest: float
) -> None:
    data = golden("spectral47")
    all_wavelengths, radiance = 1e-9 * data["wavelength_nm"], data["L_orders1_4"]
    truth = convert_to_linear_srgb(torch.from_numpy(radiance), all_wavelengths.tolist())
    few = np.stack([np.interp(nodes, data["wavelength_nm"], row) for row in radiance])
    found = convert_to_linear_srgb(torch.from_numpy(few), [1e-9 * node for node in nodes])
    error = (found - truth).abs().amax(-1) / truth.amax(-1)
    assert float(error.median()) < median
    assert float(error.max()) < largest
    shifted = convert_to_linear_srgb(torch.from_numpy(few[:, ::-1].copy()), [1e-9 * node for node in nodes])
    assert float(((shifted - truth).abs().amax(-1) / truth.amax(-1)).median()) > 2.0 * median


@pytest.mark.parametrize("wavelengths", [(), (550e-9, 550e-9), (300e-9, 500e-9), (440e-9, 550e-9, 680e-9, 700e-9)])
def test_other_wavelengths_are_refused(wavelengths: tuple[float, ...]) -> None:
    with pytest.raises(ParameterError):
        convert_to_xyz(torch.ones(2), wavelengths)
