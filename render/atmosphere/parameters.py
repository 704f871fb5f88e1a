"""What an atmosphere is made of: layers of density, coefficients per wavelength, the ground below and the sun above."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from render.errors import ParameterError

Spectrum = tuple[float, ...]
"""One number per wavelength."""


@dataclass(frozen=True)
class DensityLayer:
    """Density of a kind of particle within a layer, relative to its largest value.

        density(h) = clamp(exp_term exp(exp_scale h) + linear_term h + constant_term, 0, 1),   h the altitude [m]

    Args:
        width: thickness of the layer [m]; the topmost layer has no upper end, whatever its width.
        exp_term: factor of the exponential [1].
        exp_scale: rate of the exponential [1/m], negative where the density falls with altitude.
        linear_term: slope [1/m].
        constant_term: constant [1].

    Raises:
        ParameterError: if a number is not finite, or the width is negative.
    """

    width: float = 0.0
    exp_term: float = 0.0
    exp_scale: float = 0.0
    linear_term: float = 0.0
    constant_term: float = 0.0

    def __post_init__(self) -> None:
        for name in ("width", "exp_term", "exp_scale", "linear_term", "constant_term"):
            _check_number(f"{name} of a density layer", getattr(self, name))
        _check_at_least("width of a density layer", self.width, 0.0, "m")


@dataclass(frozen=True)
class DensityProfile:
    """Layers from the ground upwards.

    Args:
        layers: at least one; each begins where the one below ends.

    Raises:
        ParameterError: if there is no layer.
    """

    layers: tuple[DensityLayer, ...]

    def __post_init__(self) -> None:
        if not self.layers:
            raise ParameterError("a density profile needs at least one layer; DensityLayer() is empty space")

    @property
    def boundaries(self) -> tuple[float, ...]:
        """Altitudes at which one layer gives way to the next [m]; one fewer than there are layers."""
        heights, top = [], 0.0
        for layer in self.layers[:-1]:
            top += layer.width
            heights.append(top)
        return tuple(heights)


def exponential_profile(scale_height: float) -> DensityProfile:
    """Density exp(-altitude / scale_height), the scale height in [m]."""
    _check_positive("scale height", scale_height, "m")
    return DensityProfile((DensityLayer(exp_term=1.0, exp_scale=-1.0 / scale_height),))


def tent_profile(centre: float, half_width: float) -> DensityProfile:
    """Density that rises to 1 at an altitude `centre` [m] and falls to 0 within `half_width` [m] on both sides."""
    _check_positive("altitude of the tent's peak", centre, "m")
    _check_positive("half width of the tent", half_width, "m")
    slope = 1.0 / half_width
    rising = DensityLayer(width=centre, linear_term=slope, constant_term=1.0 - centre * slope)
    falling = DensityLayer(linear_term=-slope, constant_term=1.0 + centre * slope)
    return DensityProfile((rising, falling))


def uniform_profile() -> DensityProfile:
    """Density 1 everywhere."""
    return DensityProfile((DensityLayer(constant_term=1.0),))


def evaluate_density(profile: DensityProfile, altitude: Tensor) -> Tensor:
    """Density relative to the largest [1], at altitudes [m] of any shape; a layer begins at its lower boundary."""
    density = _evaluate_layer(profile.layers[0], altitude)
    for boundary, layer in zip(profile.boundaries, profile.layers[1:], strict=True):
        density = torch.where(altitude < boundary, density, _evaluate_layer(layer, altitude))
    return density


def _evaluate_layer(layer: DensityLayer, altitude: Tensor) -> Tensor:
    density = layer.linear_term * altitude + layer.constant_term
    if layer.exp_term:
        density = density + layer.exp_term * torch.exp(layer.exp_scale * altitude)
    return density.clamp(0.0, 1.0)


@dataclass(frozen=True)
class AtmosphereParameters:
    """A spherical planet, the air around it, and its sun.

    Args:
        bottom_radius: of the ground [m].
        top_radius: where the air ends [m].
        wavelengths: [m], any number of them; each spectrum below has one number for each.
        solar_irradiance: at the top of the air, on a surface that faces the sun [W/m^2/nm].
        sun_angular_radius: half the angle under which the sun is seen [rad].
        rayleigh_scattering: of air at its largest density [1/m].
        rayleigh_density: profile of the air.
        mie_scattering: of aerosols at their largest density [1/m].
        mie_extinction: scattering and absorption by aerosols at their largest density [1/m].
        mie_density: profile of the aerosols.
        mie_asymmetry: parameter g of their Cornette-Shanks phase function [1], between -1 and 1.
        absorption_extinction: of what absorbs only, ozone on Earth, at its largest density [1/m].
        absorption_density: profile of the absorber.
        ground_albedo: reflected share of the light that falls on the ground, 0..1 [1].
        min_cos_sun_zenith: cosine of the largest angle between zenith and sun that the tables cover [1].

    Raises:
        ParameterError: if a number is not finite or outside its domain, or a spectrum has another length than `wavelengths`.
    """

    bottom_radius: float
    top_radius: float
    wavelengths: Spectrum
    solar_irradiance: Spectrum
    sun_angular_radius: float
    rayleigh_scattering: Spectrum
    rayleigh_density: DensityProfile
    mie_scattering: Spectrum
    mie_extinction: Spectrum
    mie_density: DensityProfile
    mie_asymmetry: float
    absorption_extinction: Spectrum
    absorption_density: DensityProfile
    ground_albedo: Spectrum
    min_cos_sun_zenith: float

    def __post_init__(self) -> None:
        _check_planet(self.bottom_radius, self.top_radius)
        _check_sun(self.sun_angular_radius, self.min_cos_sun_zenith)
        if not -1.0 < self.mie_asymmetry < 1.0:
            raise ParameterError(f"mie_asymmetry must lie between -1 and 1, not {self.mie_asymmetry}")
        for name in ("wavelengths", "solar_irradiance", "rayleigh_scattering", "mie_scattering", "mie_extinction"):
            self._check_spectrum(name)
        self._check_spectrum("absorption_extinction")
        self._check_spectrum("ground_albedo", 1.0)
        if not self.wavelengths or min(self.wavelengths) <= 0.0:
            raise ParameterError(f"an atmosphere needs positive wavelengths [m], not {self.wavelengths}")
        if any(s > e for s, e in zip(self.mie_scattering, self.mie_extinction, strict=True)):
            raise ParameterError(
                f"mie_extinction {self.mie_extinction} 1/m includes mie_scattering {self.mie_scattering} 1/m and cannot be "
                "smaller"
            )

    def _check_spectrum(self, name: str, largest: float = math.inf) -> None:
        values = getattr(self, name)
        if len(values) != len(self.wavelengths):
            raise ParameterError(
                f"{name} has {len(values)} numbers for {len(self.wavelengths)} wavelengths; give one each"
            )
        for value in values:
            _check_number(name, value)
            if not 0.0 <= value <= largest:
                raise ParameterError(f"{name} must lie between 0 and {largest:g}, not {value}")

    @property
    def thickness(self) -> float:
        """Height of the air above the ground [m]."""
        return self.top_radius - self.bottom_radius

    @property
    def horizon_length(self) -> float:
        """Length of a ray that grazes the ground, from there to the top of the air [m]."""
        return math.sqrt(self.thickness * (self.top_radius + self.bottom_radius))

    def with_aerosol(self, factor: float) -> "AtmosphereParameters":
        """The same planet with so many times its aerosols.

        Raises:
            ParameterError: if the factor is negative or not finite.
        """
        _check_number("aerosol factor", factor)
        _check_at_least("aerosol factor", factor, 0.0, "1")
        return replace(
            self,
            mie_scattering=tuple(factor * value for value in self.mie_scattering),
            mie_extinction=tuple(factor * value for value in self.mie_extinction),
        )


def spectrum_tensor(values: Sequence[float], like: Tensor) -> Tensor:
    """A spectrum as a tensor `(wavelength,)` with type and device of another tensor."""
    return torch.tensor(values, dtype=like.dtype, device=like.device)


def extinctions_at(atmosphere: AtmosphereParameters, altitude: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Coefficients of the air at an altitude.

    Args:
        atmosphere: the planet.
        altitude: above the ground `(...)` [m].

    Returns:
        Rayleigh scattering, Mie scattering, and the extinction by all of them together, each `(..., wavelength)` [1/m].
    """
    rayleigh = evaluate_density(atmosphere.rayleigh_density, altitude)[..., None]
    mie = evaluate_density(atmosphere.mie_density, altitude)[..., None]
    absorber = evaluate_density(atmosphere.absorption_density, altitude)[..., None]
    rayleigh_scattering = rayleigh * spectrum_tensor(atmosphere.rayleigh_scattering, altitude)
    mie_scattering = mie * spectrum_tensor(atmosphere.mie_scattering, altitude)
    extinction = (
        rayleigh_scattering
        + mie * spectrum_tensor(atmosphere.mie_extinction, altitude)
        + absorber * spectrum_tensor(atmosphere.absorption_extinction, altitude)
    )
    return rayleigh_scattering, mie_scattering, extinction


def _check_planet(bottom: float, top: float) -> None:
    _check_positive("bottom_radius", bottom, "m")
    _check_number("top_radius", top)
    if not bottom < top:
        raise ParameterError(f"the air must end above the ground: top_radius {top} m, bottom_radius {bottom} m")


def _check_sun(angular_radius: float, min_cosine: float) -> None:
    if not 0.0 < angular_radius < 0.5 * math.pi:
        raise ParameterError(
            f"sun_angular_radius must lie between 0 and pi/2 rad, not {angular_radius}; a sun without extent has no radiance"
        )
    if not -1.0 <= min_cosine < 1.0:
        raise ParameterError(f"min_cos_sun_zenith must be at least -1 and smaller than 1, not {min_cosine}")


def _check_number(name: str, value: float) -> None:
    if not math.isfinite(value):
        raise ParameterError(f"{name} must be a finite number, not {value}")


def _check_at_least(name: str, value: float, least: float, unit: str) -> None:
    if value < least:
        raise ParameterError(f"{name} must be at least {least:g} {unit}, not {value}")


def _check_positive(name: str, value: float, unit: str) -> None:
    _check_number(name, value)
    if value <= 0.0:
        raise ParameterError(f"{name} must be positive, not {value} {unit}")
