"""Light that falls on a horizontal surface: from the sun's disc, and from the sky by each order of scattering."""

import math

import torch
from torch import Tensor

from precompute.atmosphere.quadratures import DirectionRule
from precompute.atmosphere.scattering_density import ScatteredOrder
from render.atmosphere.air_ray import AirRay
from render.atmosphere.parameters import AtmosphereParameters, spectrum_tensor
from render.atmosphere.ray_geometry import sine_from_cosine
from render.atmosphere.tables import TableSizes, irradiance_nodes
from render.atmosphere.transmittance import look_up_transmittance_to_top


def compute_direct_irradiance(
    atmosphere: AtmosphereParameters, transmittance: Tensor, radius: Tensor, cos_sun: Tensor
) -> Tensor:
    """Irradiance of a horizontal surface by the sun's disc, part of which may have set.

        E T(mu_s) c,   c = 0 below -alpha, (mu_s + alpha)^2 / (4 alpha) within alpha of the horizon, mu_s above

    Args:
        atmosphere: the planet; alpha is the angular radius of its sun, E the solar irradiance.
        transmittance: table `(radius, view, wavelength)` [1].
        radius: of the surface from the centre `(...)` [m].
        cos_sun: cosine mu_s between sun and zenith `(...)`.

    Returns:
        Irradiance `(..., wavelength)` [W/m^2/nm].
    """
    alpha = atmosphere.sun_angular_radius
    partial = (cos_sun.clamp(-alpha, alpha) + alpha).square() / (4.0 * alpha)
    average = torch.where(cos_sun > alpha, cos_sun, partial)
    passing = look_up_transmittance_to_top(atmosphere, transmittance, radius, cos_sun)
    return passing * average[..., None].to(passing.dtype) * spectrum_tensor(atmosphere.solar_irradiance, passing)


def compute_indirect_irradiance(
    atmosphere: AtmosphereParameters, order: ScatteredOrder, radius: Tensor, cos_sun: Tensor, rule: DirectionRule
) -> Tensor:
    """Irradiance of a horizontal surface by the sky above it: the integral of L cos(theta) over the upper hemisphere.

    Args:
        atmosphere: the planet.
        order: light of one order of scattering.
        radius: of the surface from the centre `(...)` [m].
        cos_sun: cosine between sun and zenith `(...)`.
        rule: of the integral.

    Returns:
        Irradiance `(..., wavelength)` [W/m^2/nm].
    """
    angles, weights = rule.polar_nodes(0.5 * math.pi)
    azimuths, shares = rule.azimuth_nodes()
    radius, sun = (value[..., None] for value in torch.broadcast_tensors(radius, cos_sun))
    total = torch.zeros((), dtype=order.tables[0].dtype)
    for angle, weight in zip(angles, weights, strict=True):
        cosine, sine = torch.cos(angle), torch.sin(angle)
        to_sun = sine * torch.cos(azimuths) * sine_from_cosine(sun) + cosine * sun
        upwards = AirRay(radius, cosine, sun, to_sun, torch.tensor(False))
        light = order.radiance(atmosphere, upwards)
        total = total + (light * (shares * weight * cosine)[:, None].to(light.dtype)).sum(-2)
    return total


def build_direct_irradiance(atmosphere: AtmosphereParameters, sizes: TableSizes, transmittance: Tensor) -> Tensor:
    """Table of the irradiance by the sun `(radius, sun, wavelength)` [W/m^2/nm]."""
    return compute_direct_irradiance(atmosphere, transmittance, *irradiance_nodes(atmosphere, sizes))


def build_indirect_irradiance(
    atmosphere: AtmosphereParameters, sizes: TableSizes, order: ScatteredOrder, rule: DirectionRule
) -> Tensor:
    """Table of the irradiance by light of one order of scattering `(radius, sun, wavelength)` [W/m^2/nm]."""
    return compute_indirect_irradiance(atmosphere, order, *irradiance_nodes(atmosphere, sizes), rule)
