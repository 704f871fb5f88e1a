"""Sunlight that fog scatters once into a view ray, without phase function and albedo.

With the view's optical depth tau(t), the extinction sigma(t) and the optical depth A(t) from there to the sun, the
in-scattering is

    S = integral of sigma(t) exp(-tau(t) - A(t)) dt = integral of exp(-tau - A) dtau.

In a layered medium both optical depths are integrals of the same extinction over the same heights: while the ray
gains dtau it climbs through v dtau of vertical optical depth, v being its slope, and the sun's light, of slope l, is
spared v / l dtau. The exponent E = tau + A is thus linear in tau, whatever the profile:

    A = A_0 - tau v / l,   S = tau (exp(-E_0) - exp(-E_1)) / (E_1 - E_0)

with E at the two ends of the ray. Taken term by term over the distance, a linear profile asks for error functions and
an exponential one for exponential integrals; all of them cancel. Written as tau times the mean of exp(-E), S has no
singular direction: not v = 0, nor l = 0, nor v = l.
"""

import math

import torch
from torch import Tensor

from render.errors import ParameterError
from render.media.layer import (
    LayeredMedium,
    Number,
    compute_optical_depth,
    cut_ray,
    invert_section,
    light_depth,
    match_rays,
    section_depth,
)
from render.media.special_functions import exponential_mean

DEEPEST = 60.0
"""Optical depth at which a ray without end is cut over round ground: exp(-60) is below the rounding of float64."""


def compute_transmittance(medium: LayeredMedium, height: Number, slope: Number, distance: Number = math.inf) -> Tensor:
    """Share of the light that passes along a ray: exp(-optical depth).

    Args:
        medium: the layer.
        height: of the beginning of the ray [m].
        slope: vertical component of the unit direction [1].
        distance: length of the ray [m]; may be infinite.

    Returns:
        Transmittance [1], broadcast shape.

    Raises:
        ParameterError: see `compute_optical_depth`.
    """
    return torch.exp(-compute_optical_depth(medium, height, slope, distance))


def compute_in_scattering(
    medium: LayeredMedium, height: Number, slope: Number, sun_slope: Number, distance: Number = math.inf
) -> Tensor:
    """In-scattered sunlight along a view ray, single scattering.

    The radiance is albedo times irradiance of the sun times phase function times this.

    Args:
        medium: the layer.
        height: of the eye [m], inside, above or below the layer.
        slope: vertical component of the unit direction of view [1].
        sun_slope: vertical component of the unit vector towards the sun [1]; a negative one lights the layer from
            below, as without ground.
        distance: length of the ray [m]; may be infinite.

    Returns:
        S [1], broadcast shape, 0 where no light arrives.

    Raises:
        ParameterError: see `compute_optical_depth`.
    """
    height, slope, distance, sun_slope = match_rays(height, slope, distance, sun_slope)
    section = cut_ray(medium, height - medium.datum, slope, distance)
    depth = section_depth(medium, section, slope)
    first = light_depth(medium, section.first, sun_slope)
    last = light_depth(medium, section.last, sun_slope)
    last = torch.where(section.unbounded, _light_depth_above(first, depth, slope, sun_slope), last)
    endless = torch.isinf(depth)
    view = torch.where(endless, 0.0, depth)
    ended = view * exponential_mean(first, view + last)
    return torch.where(endless, _endless(first, slope, sun_slope), ended)


def _light_depth_above(first: Tensor, depth: Tensor, slope: Tensor, sun_slope: Tensor) -> Tensor:
    """A at the end of a ray that rises for ever: nothing under a sun above, A_0 - tau v / l lit from below."""
    below = (sun_slope < 0.0) & torch.isfinite(first) & torch.isfinite(depth)
    gained = torch.where(below, depth, 0.0) * slope / torch.where(below, -sun_slope, 1.0)
    return torch.where(below, first + gained, torch.where(sun_slope > 0.0, 0.0, math.inf))


def _endless(first: Tensor, slope: Tensor, sun_slope: Tensor) -> Tensor:
    """S of a ray that never leaves the fog: exp(-A_0) / (1 - v / l). It is level, or goes away from the light."""
    dark = torch.isinf(first)
    lit_slope = torch.where(sun_slope == 0.0, 1.0, sun_slope)
    rate = (1.0 - slope / lit_slope).clamp(min=1.0)
    return torch.where(dark, 0.0, torch.exp(-torch.where(dark, 0.0, first)) / rate)


def compute_section_in_scattering(
    medium: LayeredMedium, height: Number, slope: Number, sun_slope: Number, start: Number, end: Number
) -> Tensor:
    """In-scattered sunlight from a part of a view ray, dimmed by the fog in front of it.

    Args:
        medium: the layer.
        height: of the eye [m].
        slope: vertical component of the unit direction of view [1].
        sun_slope: vertical component of the unit vector towards the sun [1].
        start: distance at which the part begins [m], finite.
        end: distance at which it ends [m], at least `start`; may be infinite.

    Returns:
        S of the part [1]; the parts of a ray add up to `compute_in_scattering`.

    Raises:
        ParameterError: see `compute_optical_depth`; also for an end before the start.
    """
    height, slope, start, sun_slope = match_rays(height, slope, start, sun_slope)
    ahead = compute_transmittance(medium, height, slope, start)
    return ahead * compute_in_scattering(medium, height + slope * start, slope, sun_slope, end - start)


def compute_curved_in_scattering(
    medium: LayeredMedium,
    height: Number,
    slope: Number,
    sun_slope: Number,
    radius: float,
    distance: Number = math.inf,
    cosine: Number | None = None,
    pieces: int = 8,
) -> Tensor:
    """In-scattered sunlight along a view ray, with the sun's path over round ground: for a low sun, a set one included.

    Over round ground the path to the sun stays finite when the sun is level, and A is no longer linear in tau. The
    ray is cut into pieces of equal optical depth; A is exact (to first order in height over radius) at their ends and
    linear between. At a distance t the sun stands higher by t (cosine - v l) / radius. The view ray itself stays
    straight over flat ground. docs/fog.md has the errors.

    Args:
        medium: the layer; its base is the ground that hides the sun.
        height: of the eye [m].
        slope: v, vertical component of the unit direction of view [1].
        sun_slope: l, vertical component of the unit vector towards the sun where the eye is [1].
        radius: of the ground [m].
        distance: length of the ray [m]; may be infinite.
        cosine: of the angle between view and sun [1]; None for a sun as high everywhere along the ray.
        pieces: number of pieces, at least 1; the error falls with its square.

    Returns:
        S [1], broadcast shape.

    Raises:
        ParameterError: see `compute_optical_depth`; also for a radius that is not positive, or no pieces.
    """
    if not radius > 0.0 or pieces < 1:
        raise ParameterError(f"expected a positive radius and at least one piece, got {radius} m and {pieces}")
    height, slope, distance, sun_slope = match_rays(height, slope, distance, sun_slope)
    turning = torch.zeros_like(slope) if cosine is None else (cosine - slope * sun_slope) / radius
    section = cut_ray(medium, height - medium.datum, slope, distance)
    depth = section_depth(medium, section, slope)
    step = torch.where(torch.isinf(depth), DEEPEST, depth) / pieces

    def depth_to_sun(reached: Tensor) -> Tensor:
        """A at a distance from where the ray enters the layer; nothing at the end of a ray that rises for ever."""
        gone = torch.isinf(reached)
        flown = torch.where(gone, 0.0, reached)
        turned = (sun_slope + turning * (section.start + flown)).clamp(-1.0, 1.0)
        return torch.where(gone, 0.0, medium.curved_depth(section.first + slope * flown, turned, radius))

    total, before = torch.zeros_like(depth), depth_to_sun(torch.zeros_like(depth))
    for piece in range(1, pieces + 1):
        reached = invert_section(medium, section.first, slope, step * piece)
        after = step * piece + depth_to_sun(torch.where(torch.isinf(reached), section.length, reached))
        total = total + step * exponential_mean(before, after)
        before = after
    return total
