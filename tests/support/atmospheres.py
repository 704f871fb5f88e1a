"""Planets to test with, the numbers of Bruneton's reference, and small tables of the Earth that are built once."""

import functools
import math

import numpy as np
import torch
from torch import Tensor

from precompute.atmosphere_tables import OrderState, TablePlan, build_first_order, build_next_order
from render.atmosphere.air_ray import AirRay
from render.atmosphere.earth import earth
from render.atmosphere.parameters import (
    AtmosphereParameters,
    DensityLayer,
    DensityProfile,
    exponential_profile,
)
from render.atmosphere.tables import TableSizes
from tests.support.shared_data import shared_file

SMALL = TableSizes(16, 64, 4, 16, 8, 32, 4, 8)
"""The sizes of `textures_small.npz`."""

PARITY = 1e-7
"""Largest difference from the reference, of an array's largest value. Compiled with fused multiply-add it moves by 6e-9 itself."""

KM = 1000.0
EMPTY = DensityProfile((DensityLayer(),))


def planet(
    asymmetry: float = 0.0,
    ground_albedo: float = 0.1,
    mie: float = 1.0,
    absorption: tuple[float, ...] = (0.0, 0.0),
    absorber: DensityProfile = EMPTY,
) -> AtmosphereParameters:
    """The planet of the reference's own tests, small and with deep air; the second wavelength has other coefficients than the first."""
    return AtmosphereParameters(
        bottom_radius=1000.0 * KM,
        top_radius=1500.0 * KM,
        wavelengths=(550e-9, 440e-9),
        solar_irradiance=(123.0, 77.0),
        sun_angular_radius=0.004,
        rayleigh_scattering=(1e-3 / KM, 2e-3 / KM),
        rayleigh_density=exponential_profile(60.0 * KM),
        mie_scattering=(mie * 1.5e-3 / KM, mie * 1.1e-3 / KM),
        mie_extinction=(mie * 2e-3 / KM, mie * 1.3e-3 / KM),
        mie_density=exponential_profile(30.0 * KM),
        mie_asymmetry=asymmetry,
        absorption_extinction=absorption,
        absorption_density=absorber,
        ground_albedo=(ground_albedo, 0.5 * ground_albedo),
        min_cos_sun_zenith=-1.0,
    )


def golden(name: str) -> dict[str, np.ndarray]:
    """Arrays of a file of the reference's numbers; skips where it is absent."""
    with np.load(shared_file(f"golden/bruneton/{name}.npz")) as file:
        return dict(file)


def peak_error(found: Tensor, expected: np.ndarray) -> float:
    """Largest difference, of the largest expected value; NaN counts as infinite."""
    difference = np.abs(found.double().numpy() - expected) / np.abs(expected).max()
    return float(np.nan_to_num(difference, nan=math.inf).max())


@functools.cache
def small_states(precision: str = "float64") -> tuple[OrderState, ...]:
    """States after one to four orders of the Earth's small tables."""
    plan = TablePlan(sizes=SMALL, precision=precision)
    states = [build_first_order(earth(), plan)]
    while len(states) < plan.orders:
        states.append(build_next_order(earth(), plan, states[-1]))
    return tuple(states)


def tensor(*values: float) -> Tensor:
    """Numbers in float64 `(...)`; one alone has no dimension."""
    return torch.tensor(values[0] if len(values) == 1 else values, dtype=torch.float64)


def ray(atmosphere: AtmosphereParameters, radius: float, view: float, sun: float, view_sun: float) -> AirRay:
    """One ray by its four numbers."""
    return AirRay.towards(atmosphere, tensor(radius), tensor(view), tensor(sun), tensor(view_sun))


def just_below_horizon(atmosphere: AtmosphereParameters, radius: float, by: float = 1e-3) -> float:
    """Cosine of a ray that meets the ground, only just."""
    return -math.sqrt(1.0 - (atmosphere.bottom_radius / radius) ** 2) - by
