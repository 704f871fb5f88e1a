"""Distances along a ray at which fog scatters: density, cumulative distribution, its inverse and samples.

Two distributions, both conditional on an event within the ray's length. Without a sun, that of collisions: the
density is sigma(t) exp(-tau(t)) over its integral. With a sun, that of the light that arrives: sigma(t) exp(-tau(t) -
A(t)) over its integral S (`in_scattering`). In units of the optical depth tau both are exponential, exp(-k tau) on
0..tau_1, with k = 1 or k = 1 - v / l, of either sign:

    cdf = tau m(k tau) / (tau_1 m(k tau_1)),   m(x) = (1 - exp(-x)) / x
    inverse: tau / tau_1 = -log(1 - u (1 - exp(-x))) / x,   x = k tau_1

A ray on which nothing can happen, for want of fog or light, has density and cumulative distribution 0 and inverse infinity.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.media.layer import (
    LayeredMedium,
    Number,
    compute_optical_depth,
    cut_ray,
    find_distance,
    light_depth,
    match,
    match_rays,
    section_depth,
)
from render.media.special_functions import exponential_moment, log_ratio


@dataclass(frozen=True, eq=False)
class FlightDistribution:
    """Distances to the events along rays; everything broadcasts.

    Args:
        medium: the layer.
        height: of the beginnings of the rays [m].
        slope: vertical component of their unit directions [1].
        sun_slope: vertical component of the unit vector towards the sun [1]; None for collisions, lit or not.
        distance: lengths of the rays [m]; may be infinite.
    """

    medium: LayeredMedium
    height: Number
    slope: Number
    sun_slope: Number | None = None
    distance: Number = math.inf

    def evaluate_pdf(self, distance: Number) -> Tensor:
        """Density of the distance to the event.

        Args:
            distance: t [m], not negative.

        Returns:
            Density [1/m], 0 beyond the length of the ray and outside the layer.

        Raises:
            ParameterError: see `compute_optical_depth`.
        """
        depth, total, rate = self._depths(distance)
        height, slope, distance, length = match(self.height, self.slope, distance, self.distance)
        section = cut_ray(self.medium, height - self.medium.datum, slope, length)
        flown = distance - section.start
        inside = (flown >= 0.0) & (flown <= section.length) & torch.isfinite(flown) & (total > 0.0)
        extinction = self.medium.extinction_at(section.first + slope * torch.where(inside, flown, 0.0))
        return torch.where(inside, extinction * _density(depth, total, rate), 0.0)

    def evaluate_cdf(self, distance: Number) -> Tensor:
        """Probability that the event comes no later than a distance t [m], in 0..1, accurate relative to itself."""
        depth, total, rate = self._depths(distance)
        return _cumulative(depth, total, rate)

    def invert_cdf(self, uniform: Tensor) -> Tensor:
        """Distance below which the event comes with a given probability.

        Args:
            uniform: u, probabilities in 0..1.

        Returns:
            Distance [m], at most the length of the ray; infinite where there is no event.

        Raises:
            ParameterError: see `compute_optical_depth`.
        """
        _, total, rate = self._depths(0.0)
        depth = _quantile(uniform, total, rate)
        flown = find_distance(self.medium, self.height, self.slope, depth)
        # The end of the ray has depth tau_1 but for rounding, which must not throw the event off the ray.
        height, slope, distance = match(self.height, self.slope, self.distance)
        section = cut_ray(self.medium, height - self.medium.datum, slope, distance)
        flown = torch.minimum(flown, section.start + section.length)
        return torch.where(total > 0.0, flown, math.inf)

    def sample_distance(self, shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
        """Random distances to the event [m].

        Args:
            shape: of the result; the rays broadcast to it.
            generator: of random numbers.

        Returns:
            Distances [m] of that shape, of the type of the rays.

        Raises:
            ParameterError: see `compute_optical_depth`.
        """
        dtype = self._depths(0.0)[1].dtype
        return self.invert_cdf(torch.rand(shape, generator=generator, dtype=dtype, device=generator.device))

    def _depths(self, distance: Number) -> tuple[Tensor, Tensor, Tensor]:
        """Optical depth to a distance and of the whole ray, and the rate k; all 0 where nothing can happen."""
        sun = 1.0 if self.sun_slope is None else self.sun_slope
        height, slope, length, sun_slope = match_rays(self.height, self.slope, self.distance, sun)
        section = cut_ray(self.medium, height - self.medium.datum, slope, length)
        total = section_depth(self.medium, section, slope)
        depth = compute_optical_depth(self.medium, height, slope, distance)
        rate = torch.ones_like(total)
        if self.sun_slope is not None:
            lit_slope = torch.where(sun_slope == 0.0, 1.0, sun_slope)
            lit = torch.isfinite(light_depth(self.medium, section.first, sun_slope)) & (sun_slope != 0.0)
            total = torch.where(lit, total, 0.0)
            rate = torch.where(lit & (total > 0.0), 1.0 - slope / lit_slope, 1.0)
        depth, total, rate = torch.broadcast_tensors(depth, total, rate)
        return torch.minimum(depth, total), total, rate


def _density(depth: Tensor, total: Tensor, rate: Tensor) -> Tensor:
    """Density of the optical depth [1]: exp(-k tau) / (tau_1 m(k tau_1)), for k < 0 counted from the far end."""
    endless = torch.isinf(total)
    finite = torch.where(endless | (total == 0.0), 1.0, total)
    gone = torch.where(rate >= 0.0, depth, finite - torch.minimum(depth, finite))
    gone = torch.where(endless & torch.isinf(depth), math.inf, gone)
    size = torch.where(endless, 1.0 / torch.where(endless, rate, 1.0), finite * exponential_moment(rate.abs() * finite))
    return torch.exp(-rate.abs() * gone) / size


def _cumulative(depth: Tensor, total: Tensor, rate: Tensor) -> Tensor:
    """Cumulative distribution of the optical depth [1]; for k < 0 exp(-|k| (tau_1 - tau)) times that of |k|."""
    steep = rate.abs()
    endless, empty = torch.isinf(total), total == 0.0
    finite = torch.where(endless | empty, 1.0, total)
    within = torch.minimum(depth, finite)
    share = within * exponential_moment(steep * within) / (finite * exponential_moment(steep * finite))
    share = share * torch.exp(torch.where(rate < 0.0, -steep * (finite - within), 0.0))
    share = torch.where(endless, -torch.expm1(-steep * depth), share)
    return torch.where(empty, 0.0, share)


def _quantile(uniform: Tensor, total: Tensor, rate: Tensor) -> Tensor:
    """Optical depth below which lies a given probability [1]."""
    uniform, total, rate = torch.broadcast_tensors(uniform, total, rate)
    endless = torch.isinf(total)
    finite = torch.where(endless, 1.0, total)
    x = rate * finite
    # Beyond this the exponentials of a negative rate overflow, and all the probability lies at the far end.
    steep = x < -0.5 * math.log(torch.finfo(x.dtype).max)
    gentle = torch.where(steep, 0.0, x)
    moment = exponential_moment(gentle)
    share = uniform * moment * log_ratio((uniform * gentle * moment).clamp(max=1.0))
    far = torch.where(steep, x, -1.0)
    share = torch.where(steep, 1.0 - torch.log(uniform + (1.0 - uniform) * torch.exp(far)) / far, share)
    depth = finite * share.clamp(max=1.0)
    return torch.where(endless, uniform * log_ratio(uniform) / torch.where(endless, rate, 1.0), depth)
