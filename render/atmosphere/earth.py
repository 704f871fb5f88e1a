"""The atmosphere of the Earth at any visible wavelengths, with the sources of its numbers."""

import math
from collections.abc import Sequence

import numpy as np

from render.atmosphere.parameters import AtmosphereParameters, exponential_profile, tent_profile
from render.errors import ParameterError
from render.units import METRES_PER_NANOMETRE, radians_from_degrees

DEFAULT_WAVELENGTHS = (680e-9, 550e-9, 440e-9)
"""Red, green and blue [m]."""

SAMPLED_WAVELENGTHS = tuple(360.0 + 10.0 * i for i in range(48))
"""Wavelengths of the two tables below, in nanometres. A number is the mean over the 10 nm that begin there; between them they are
interpolated linearly."""

# Extraterrestrial irradiance [W/m^2/nm]: ASTM G173-03, reference spectra derived from SMARTS, means of 10 nm.
# fmt: off
SOLAR_IRRADIANCE = (
    1.11776, 1.14259, 1.01249, 1.14716, 1.72765, 1.73054, 1.6887, 1.61253, 1.91198, 2.03474, 2.02042, 2.02212,
    1.93377, 1.95809, 1.91686, 1.8298, 1.8685, 1.8931, 1.85149, 1.8504, 1.8341, 1.8345, 1.8147, 1.78158,
    1.7533, 1.6965, 1.68194, 1.64654, 1.6048, 1.52143, 1.55622, 1.5113, 1.474, 1.4482, 1.41018, 1.36775,
    1.34188, 1.31429, 1.28303, 1.26758, 1.2367, 1.2082, 1.18737, 1.14683, 1.12362, 1.1058, 1.07124, 1.04992,
)

# Absorption cross section of ozone at 233 K [m^2]: Gorshelev, Serdyuchenko et al. 2014, University of Bremen, means of 10 nm.
OZONE_CROSS_SECTION = (
    1.18e-27, 2.182e-28, 2.818e-28, 6.636e-28, 1.527e-27, 2.763e-27, 5.52e-27, 8.451e-27, 1.582e-26, 2.316e-26,
    3.669e-26, 4.924e-26, 7.752e-26, 9.016e-26, 1.48e-25, 1.602e-25, 2.139e-25, 2.755e-25, 3.091e-25, 3.5e-25,
    4.266e-25, 4.672e-25, 4.398e-25, 4.701e-25, 5.019e-25, 4.305e-25, 3.74e-25, 3.215e-25, 2.662e-25, 2.238e-25,
    1.852e-25, 1.473e-25, 1.209e-25, 9.423e-26, 7.455e-26, 6.566e-26, 5.105e-26, 4.15e-26, 4.228e-26, 3.237e-26,
    2.451e-26, 2.801e-26, 2.534e-26, 1.624e-26, 1.465e-26, 2.078e-26, 1.383e-26, 7.105e-27,
)
# fmt: on

# Rayleigh scattering at the ground is this times (wavelength / 1 um)^-4 [1/m]. It is the reference's number, and to 4e-4 that of
# 8 pi^3 (n^2 - 1)^2 (6 + 3 d) / (3 N lambda^4 (6 - 7 d)) with an index n = 1.0003, N = 2.545e25 [1/m^3] and a depolarisation d = 0.035.
# Measured indices make it less: table 3 of Penndorf 1957 has 30.6, 12.26 and 5.178e-6 1/m at 440, 550 and 680 nm, 8 to 12 % below this.
RAYLEIGH_AT_ONE_MICROMETRE = 1.24062e-6
RAYLEIGH_SCALE_HEIGHT = 8000.0
# Aerosols of clear continental air: vertical optical depth beta (wavelength / 1 um)^-alpha (Angstrom's law), of which 0.9 is scattered.
ANGSTROM_ALPHA, ANGSTROM_BETA = 0.0, 5.328e-3
AEROSOL_ALBEDO, AEROSOL_SCALE_HEIGHT, AEROSOL_ASYMMETRY = 0.9, 1200.0, 0.8
# A column of 300 Dobson units, within a tent 30 km wide and highest at 25 km.
DOBSON_UNITS, MOLECULES_PER_DOBSON_UNIT = 300.0, 2.687e20
OZONE_PEAK, OZONE_HALF_WIDTH = 25_000.0, 15_000.0
BOTTOM_RADIUS, TOP_RADIUS = 6_360_000.0, 6_420_000.0
SUN_ANGULAR_RADIUS_DEG = 0.2678
LARGEST_SUN_ZENITH_DEG = 102.0


def earth(wavelengths: Sequence[float] = DEFAULT_WAVELENGTHS, *, ground_albedo: float = 0.1) -> AtmosphereParameters:
    """The clear atmosphere of the Earth.

    The numbers are those of Bruneton's 2017 reference, which names their sources; they stand above.

    Args:
        wavelengths: 360e-9 to 830e-9 [m], in any order.
        ground_albedo: of the ground at every wavelength, 0..1 [1].

    Returns:
        The parameters.

    Raises:
        ParameterError: if a wavelength is outside the tables, or the albedo is not an albedo.
    """
    lengths = tuple(float(value) for value in wavelengths)
    # Rounded far below any meaning, so that 680e-9 m is the sample at 680 nm and not the last bit beside it.
    nanometres = np.round(np.array(lengths) / METRES_PER_NANOMETRE, 6)
    if not bool(((nanometres >= SAMPLED_WAVELENGTHS[0]) & (nanometres <= SAMPLED_WAVELENGTHS[-1])).all()):
        raise ParameterError(f"the spectra of the Earth are known from 360e-9 to 830e-9 m, not at {lengths}")
    micrometres = 1e-3 * nanometres
    mie_extinction = ANGSTROM_BETA / AEROSOL_SCALE_HEIGHT * micrometres**-ANGSTROM_ALPHA
    peak_ozone = DOBSON_UNITS * MOLECULES_PER_DOBSON_UNIT / OZONE_HALF_WIDTH
    return AtmosphereParameters(
        bottom_radius=BOTTOM_RADIUS,
        top_radius=TOP_RADIUS,
        wavelengths=lengths,
        solar_irradiance=_floats(np.interp(nanometres, SAMPLED_WAVELENGTHS, SOLAR_IRRADIANCE)),
        sun_angular_radius=radians_from_degrees(SUN_ANGULAR_RADIUS_DEG),
        rayleigh_scattering=_floats(RAYLEIGH_AT_ONE_MICROMETRE * micrometres**-4.0),
        rayleigh_density=exponential_profile(RAYLEIGH_SCALE_HEIGHT),
        mie_scattering=_floats(AEROSOL_ALBEDO * mie_extinction),
        mie_extinction=_floats(mie_extinction),
        mie_density=exponential_profile(AEROSOL_SCALE_HEIGHT),
        mie_asymmetry=AEROSOL_ASYMMETRY,
        absorption_extinction=_floats(peak_ozone * np.interp(nanometres, SAMPLED_WAVELENGTHS, OZONE_CROSS_SECTION)),
        absorption_density=tent_profile(OZONE_PEAK, OZONE_HALF_WIDTH),
        ground_albedo=(ground_albedo,) * len(lengths),
        min_cos_sun_zenith=math.cos(radians_from_degrees(LARGEST_SUN_ZENITH_DEG)),
    )


def _floats(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
