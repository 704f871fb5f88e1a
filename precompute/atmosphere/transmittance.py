"""Transmittance to the top of the air: the optical depth of each kind of particle, by quadrature along the ray."""

import torch
from torch import Tensor

from precompute.atmosphere.quadratures import LineRule
from render.atmosphere.parameters import AtmosphereParameters, DensityProfile, evaluate_density, spectrum_tensor
from render.atmosphere.ray_geometry import distance_to_top_boundary, radius_along_ray
from render.atmosphere.tables import TableSizes, transmittance_nodes


def compute_optical_length_to_top(
    atmosphere: AtmosphereParameters, profile: DensityProfile, radius: Tensor, cosine: Tensor, rule: LineRule
) -> Tensor:
    """Integral of a density along a ray to the top of the air, which the ground does not stop.

    Args:
        atmosphere: the planet.
        profile: of the density.
        radius: of the origin from the centre `(...)` [m].
        cosine: between ray and zenith `(...)`.
        rule: of the integral.

    Returns:
        Optical length `(...)` [m].
    """
    positions, weights = rule.nodes()
    length = distance_to_top_boundary(atmosphere, radius, cosine)[..., None]
    altitude = radius_along_ray(atmosphere, radius[..., None], cosine[..., None], length * positions)
    return (evaluate_density(profile, altitude - atmosphere.bottom_radius) * weights).sum(-1) * length[..., 0]


def compute_transmittance_to_top(
    atmosphere: AtmosphereParameters, radius: Tensor, cosine: Tensor, rule: LineRule
) -> Tensor:
    """Transmittance from a point to the top of the air: exp(-optical depth), the ground not considered.

    Args:
        atmosphere: the planet.
        radius: of the point from the centre `(...)` [m].
        cosine: between ray and zenith `(...)`.
        rule: of the integral.

    Returns:
        Transmittance `(..., wavelength)` [1].
    """
    kinds = (
        (atmosphere.rayleigh_scattering, atmosphere.rayleigh_density),
        (atmosphere.mie_extinction, atmosphere.mie_density),
        (atmosphere.absorption_extinction, atmosphere.absorption_density),
    )
    depth = torch.zeros((), dtype=radius.dtype)
    for extinction, profile in kinds:
        length = compute_optical_length_to_top(atmosphere, profile, radius, cosine, rule)
        depth = depth + length[..., None] * spectrum_tensor(extinction, length)
    return torch.exp(-depth)


def build_transmittance(atmosphere: AtmosphereParameters, sizes: TableSizes, rule: LineRule) -> Tensor:
    """Table of the transmittance to the top of the air `(radius, view, wavelength)` [1], float64."""
    radius, cosine = transmittance_nodes(atmosphere, sizes)
    rows = [
        compute_transmittance_to_top(atmosphere, r.expand_as(mu), mu, rule)
        for r, mu in zip(radius, cosine, strict=True)
    ]
    return torch.stack(rows)
