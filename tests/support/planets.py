"""Planets whose light has a closed form, and the rays of the shared golden data."""

from dataclasses import replace

import numpy as np
import torch

from render.atmosphere.air_ray import AirRay
from render.atmosphere.earth import earth
from render.atmosphere.parameters import AtmosphereParameters, uniform_profile
from tests.support.shared_data import shared_file


def golden(name: str) -> dict[str, np.ndarray]:
    """Arrays of a file of the golden data of Bruneton's reference."""
    with np.load(shared_file(f"golden/bruneton/{name}.npz")) as file:
        return dict(file)


def golden_rays(rows: dict[str, np.ndarray], chosen: np.ndarray | slice = slice(None)) -> AirRay:
    """The rays of rows of `sky_radiance`."""
    names = ("r_m", "mu", "mu_s", "nu", "intersects_ground")
    return AirRay(*(torch.from_numpy(np.ascontiguousarray(rows[name][chosen])) for name in names))


def one_ray(radius: float, cosine: float, cos_sun_zenith: float, cos_view_sun: float, ground: bool = False) -> AirRay:
    """A single ray."""
    numbers = (torch.tensor([value], dtype=torch.float64) for value in (radius, cosine, cos_sun_zenith, cos_view_sun))
    return AirRay(*numbers, torch.tensor([ground]))


def uniform_air(
    scattering: float, *, thickness: float = 60_000.0, extinction: float | None = None, ground_albedo: float = 0.0
) -> AtmosphereParameters:
    """Air of one density whose aerosols scatter like molecules and nothing else does, at one wavelength; coefficients [1/m]."""
    base = earth((550e-9,), ground_albedo=ground_albedo)
    return replace(
        base,
        top_radius=base.bottom_radius + thickness,
        rayleigh_scattering=(0.0,),
        mie_density=uniform_profile(),
        mie_scattering=(scattering,),
        mie_extinction=(scattering if extinction is None else extinction,),
        mie_asymmetry=0.0,
        absorption_extinction=(0.0,),
    )
