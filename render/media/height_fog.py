"""Fog over a picture: the light behind it dimmed, sunlight and skylight scattered into view.

    radiance = T background + albedo [ irradiance p(cosine; g) S + ambient (1 - T) ]

T is the transmittance of the view ray, S the sunlight it gathers (`in_scattering`), p the Henyey-Greenstein function.
`ambient` is light that comes alike from everywhere and reaches every point of the fog undimmed. Its part is exact for
such light; in real fog it stands for the sky and for all sunlight scattered more than once, which single scattering
leaves out.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.camera import unit_direction
from render.errors import ParameterError
from render.media.in_scattering import compute_curved_in_scattering, compute_in_scattering
from render.media.layer import LayeredMedium, Number, compute_optical_depth, match
from render.phase_functions import check_asymmetry, evaluate_phase_function

METEOROLOGICAL_CONTRAST = 0.05
"""Share of the light that is left at the meteorological optical range (WMO Guide to Instruments, No. 8, chapter 9)."""


@dataclass(frozen=True, eq=False)
class FogLight:
    """Light that fog scatters, and how.

    Args:
        sun_direction: towards the sun `(3,)`, of any length.
        irradiance: of the sun above the fog, on a plane that faces it `(channel,)` [1, or W/m^2].
        ambient: radiance of light from everywhere `(channel,)` [1, or W/(m^2 sr)].
        asymmetry: of the Henyey-Greenstein function; water droplets have about 0.85.
        albedo: share of the extinguished light that is scattered, 0..1.

    Raises:
        ParameterError: for an asymmetry beyond +-0.999, an albedo outside 0..1, or light that is negative or not finite.
    """

    sun_direction: Tensor
    irradiance: Tensor
    ambient: Tensor
    asymmetry: float = 0.0
    albedo: float = 1.0

    def __post_init__(self) -> None:
        check_asymmetry(self.asymmetry)
        if not 0.0 <= self.albedo <= 1.0:
            raise ParameterError(f"expected an albedo in 0..1, got {self.albedo}")
        for name, light in (("irradiance", self.irradiance), ("ambient light", self.ambient)):
            if not bool((torch.isfinite(light) & (light >= 0.0)).all()):
                raise ParameterError(f"expected a finite {name} of at least 0, got {light.tolist()}")


@dataclass(frozen=True, eq=False)
class FogImage:
    """A picture seen through fog.

    Args:
        radiance: `(..., channel)` in the unit of the light.
        transmittance: of the view rays `(..., 1)`, or `(..., channel)` for coloured fog [1].
        in_scattering: light that the fog adds `(..., channel)`, part of the radiance.
    """

    radiance: Tensor
    transmittance: Tensor
    in_scattering: Tensor


def compose_fog(
    background: Tensor,
    medium: LayeredMedium,
    height: Number,
    direction: Tensor,
    distance: Tensor,
    light: FogLight,
    earth_radius: float | None = None,
) -> FogImage:
    """Put fog in front of a picture.

    Args:
        background: what is seen without fog `(..., channel)`, in the unit of the light.
        medium: the fog; its fields are numbers, or `(channel,)` for coloured fog.
        height: of the eye [m]; one number, or `(...)`.
        direction: unit directions of view `(..., 3)`.
        distance: to what is seen `(...)` [m]; infinite for the sky.
        light: sun and ambient light.
        earth_radius: of the ground [m] for sunlight that comes over the horizon; None for flat ground.

    Returns:
        The picture. Differentiable in everything.

    Raises:
        ParameterError: for shapes that do not fit, and see `compute_optical_depth`.
    """
    if background.shape[:-1] != direction.shape[:-1] or distance.shape != direction.shape[:-1]:
        raise ParameterError(
            f"expected a background (..., channel), directions (..., 3) and distances (...) of one picture, got "
            f"{tuple(background.shape)}, {tuple(direction.shape)} and {tuple(distance.shape)}"
        )
    sun = unit_direction(light.sun_direction).to(direction)
    slope = direction[..., 2:].clamp(-1.0, 1.0)
    cosine = (direction * sun).sum(-1, keepdim=True).clamp(-1.0, 1.0)
    eye = torch.as_tensor(height, dtype=direction.dtype, device=direction.device)
    eye = eye[..., None] if eye.dim() else eye
    length = distance[..., None]
    depth = compute_optical_depth(medium, eye, slope, length)
    if earth_radius is None:
        gathered = compute_in_scattering(medium, eye, slope, sun[2], length)
    else:
        gathered = compute_curved_in_scattering(medium, eye, slope, sun[2], earth_radius, length, cosine)
    sunlight = light.irradiance.to(direction) * evaluate_phase_function(cosine, light.asymmetry) * gathered
    scattered = light.albedo * (sunlight - light.ambient.to(direction) * torch.expm1(-depth))
    transmittance = torch.exp(-depth)
    return FogImage(transmittance * background + scattered, transmittance, scattered)


def ground_distance(height: Number, slope: Number, ground: Number = 0.0) -> Tensor:
    """Distance at which rays meet level ground.

    Args:
        height: of the beginning of the ray [m].
        slope: vertical component of the unit direction [1].
        ground: height of the ground [m].

    Returns:
        Distance [m], broadcast shape: 0 on the ground looking down, infinite where the ray does not meet it or begins
        below it.
    """
    height, slope, ground = match(height, slope, ground)
    falls = (slope < 0.0) & (height >= ground)
    return torch.where(falls, (height - ground) / torch.where(falls, -slope, 1.0), math.inf)


def extinction_from_visibility(visibility: float) -> float:
    """Extinction [1/m] of fog with a given meteorological optical range.

    The range V is the distance at which 5 % of the light is left: extinction = ln(20) / V. Fog has less than 1 km,
    haze up to 5 km (WMO Guide to Instruments, No. 8). Koschmieder's range is that of 2 %, ln(50) / extinction, 1.3
    times as long.

    Args:
        visibility: V [m], positive.

    Returns:
        Extinction [1/m].

    Raises:
        ParameterError: for a visibility that is not positive.
    """
    if not visibility > 0.0:
        raise ParameterError(f"expected a positive visibility, got {visibility} m")
    return -math.log(METEOROLOGICAL_CONTRAST) / visibility
