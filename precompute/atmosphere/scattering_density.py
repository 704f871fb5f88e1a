"""Light scattered at a point towards each direction: the integral of the incident light of the order before.

    J(omega) = integral over all directions omega_i of L_{n-1}(omega_i) [beta_R rho_R P_R(nu_2) + beta_M rho_M P_M(nu_2)] d omega_i,

nu_2 the cosine between both directions. L_{n-1} is light scattered n - 1 times; along rays that meet the ground, light
scattered n - 2 times and then reflected by the ground is added (Bruneton & Neyret 2008, equation 7, discretised as in
Bruneton 2017). The azimuth is counted from the plane of zenith and view.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from precompute.atmosphere.quadratures import DirectionRule
from render.atmosphere.air_ray import AirRay
from render.atmosphere.parameters import AtmosphereParameters, evaluate_density, spectrum_tensor
from render.atmosphere.ray_geometry import (
    clamp_cosine,
    distance_to_bottom_boundary,
    ray_intersects_ground,
    safe_sqrt,
    sine_from_cosine,
)
from render.atmosphere.tables import look_up_irradiance, look_up_scattering
from render.atmosphere.transmittance import look_up_transmittance
from render.cornette_shanks import evaluate_cornette_shanks
from render.rayleigh_phase import evaluate_rayleigh_phase


@dataclass(frozen=True, eq=False)
class ScatteredOrder:
    """Light of one order of scattering, as two tables or one.

    Args:
        tables: `(radius, view, view_sun, sun, wavelength)`: of the first order, light scattered by the air and by aerosols
            without their phase functions [W/m^2/nm]; of a later one its radiance alone [W/m^2/sr/nm].
        mie_asymmetry: of the aerosols' phase function.

    Raises:
        ValueError: if there are neither one nor two tables.
    """

    tables: tuple[Tensor, ...]
    mie_asymmetry: float

    def __post_init__(self) -> None:
        if len(self.tables) not in (1, 2):
            raise ValueError(
                f"expected the two tables of single scattering or the one of a later order, got {len(self.tables)}"
            )

    def phase_factors(self, cos_view_sun: Tensor) -> tuple[Tensor | None, ...]:
        """What each table is to be multiplied by `(...)` [1/sr]; None for a table that has its phase function in it."""
        if len(self.tables) == 1:
            return (None,)
        return evaluate_rayleigh_phase(cos_view_sun), evaluate_cornette_shanks(cos_view_sun, self.mie_asymmetry)

    def radiance(self, atmosphere: AtmosphereParameters, ray: AirRay) -> Tensor:
        """Radiance along rays `(..., wavelength)` [W/m^2/sr/nm], looked up."""
        total = None
        for table, factor in zip(self.tables, self.phase_factors(ray.cos_view_sun), strict=True):
            light = look_up_scattering(atmosphere, table, ray)
            light = light if factor is None else light * factor[..., None].to(light.dtype)
            total = light if total is None else total + light
        assert total is not None
        return total


def sun_direction(ray: AirRay) -> tuple[Tensor, Tensor]:
    """Horizontal components of the unit vector towards the sun, where the ray lies in the plane of x and the zenith.

    x = (nu - mu mu_s) / sqrt(1 - mu^2), 0 for a vertical ray;     y = sqrt(1 - x^2 - mu_s^2)
    """
    sine = sine_from_cosine(ray.cos_view)
    flat = sine > 0.0
    x = torch.where(flat, (ray.cos_view_sun - ray.cos_view * ray.cos_sun) / torch.where(flat, sine, 1.0), 0.0)
    return x, safe_sqrt(1.0 - x * x - ray.cos_sun * ray.cos_sun)


def compute_scattering_density(
    atmosphere: AtmosphereParameters,
    transmittance: Tensor,
    before: ScatteredOrder,
    ground_irradiance: Tensor,
    ray: AirRay,
    rule: DirectionRule,
) -> Tensor:
    """Light scattered at the origins of rays towards where they come from: J above, direction by direction.

    Args:
        atmosphere: the planet.
        transmittance: table `(radius, view, wavelength)` [1].
        before: light of the order before.
        ground_irradiance: table `(radius, sun, wavelength)` of the light that falls on the ground and belongs to that order [W/m^2/nm].
        ray: rays `(...)`; whether they meet the ground does not matter.
        rule: of the integral.

    Returns:
        Source of the next order `(..., wavelength)` [W/m^3/sr/nm].
    """
    rays = ray.expanded()
    sun_x, sun_y = sun_direction(rays)
    altitude = rays.radius - atmosphere.bottom_radius
    strengths = [
        evaluate_density(profile, altitude)[..., None] * spectrum_tensor(scattering, altitude)
        for profile, scattering in (
            (atmosphere.rayleigh_density, atmosphere.rayleigh_scattering),
            (atmosphere.mie_density, atmosphere.mie_scattering),
        )
    ]
    azimuths, azimuth_weights = rule.azimuth_nodes()
    density = torch.zeros((), dtype=transmittance.dtype)
    for angle, weight in zip(*rule.polar_nodes(math.pi), strict=True):
        cosine, sine = torch.cos(angle), torch.sin(angle)
        reflected = GroundReflection.seen(atmosphere, transmittance, rays.radius, cosine)
        for azimuth, share in zip(azimuths, azimuth_weights, strict=True):
            across = sine * torch.cos(azimuth)
            to_sun = across * sun_x + sine * torch.sin(azimuth) * sun_y + cosine * rays.cos_sun
            incident = AirRay(rays.radius, cosine.expand_as(to_sun), rays.cos_sun, to_sun, reflected.intersects_ground)
            light = before.radiance(atmosphere, incident)
            light = light + reflected.radiance(atmosphere, ground_irradiance, rays.cos_sun, to_sun)
            turned = sine_from_cosine(rays.cos_view) * across + rays.cos_view * cosine
            scattered = (
                strengths[0] * evaluate_rayleigh_phase(turned)[..., None]
                + strengths[1] * evaluate_cornette_shanks(turned, atmosphere.mie_asymmetry)[..., None]
            )
            density = density + light * scattered.to(light.dtype) * (weight * share)
    return density


@dataclass(frozen=True, eq=False)
class GroundReflection:
    """What a point sees of the ground at one angle to the zenith.

    Args:
        radius: of the point from the centre `(...)` [m].
        intersects_ground: whether the ground is seen at all `(...)`.
        distance: to it `(...)` [m], zero where it is not seen.
        factor: transmittance times albedo / pi, zero where it is not seen `(..., wavelength)` [1/sr].
        bottom_radius: of the ground [m].
    """

    radius: Tensor
    intersects_ground: Tensor
    distance: Tensor
    factor: Tensor
    bottom_radius: float

    @staticmethod
    def seen(
        atmosphere: AtmosphereParameters, transmittance: Tensor, radius: Tensor, cosine: Tensor
    ) -> "GroundReflection":
        """From points `(...)` [m] at angles with these cosines, looked up in a table of the transmittance."""
        radius, cosine = torch.broadcast_tensors(radius, cosine)
        ground = ray_intersects_ground(atmosphere, radius, cosine)
        distance = torch.where(ground, distance_to_bottom_boundary(atmosphere, radius, cosine), 0.0)
        passing = look_up_transmittance(atmosphere, transmittance, radius, cosine, distance, ground)
        factor = passing * spectrum_tensor(atmosphere.ground_albedo, passing) / math.pi
        return GroundReflection(
            radius, ground, distance, torch.where(ground[..., None], factor, 0.0), atmosphere.bottom_radius
        )

    def cos_sun(self, cos_sun: Tensor, to_sun: Tensor) -> Tensor:
        """Cosine between sun and zenith on the ground there `(...)`; `to_sun` is that between direction and sun."""
        return clamp_cosine((self.radius * cos_sun + self.distance * to_sun) / self.bottom_radius)

    def radiance(self, atmosphere: AtmosphereParameters, irradiance: Tensor, cos_sun: Tensor, to_sun: Tensor) -> Tensor:
        """Light from the ground `(..., wavelength)` [W/m^2/sr/nm] for an irradiance table [W/m^2/nm]."""
        there = self.cos_sun(cos_sun, to_sun)
        bottom = torch.full_like(there, self.bottom_radius)
        return self.factor * look_up_irradiance(atmosphere, irradiance, bottom, there)
