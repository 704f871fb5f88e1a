"""Fog that thins out exponentially with height and never ends."""

from dataclasses import dataclass

import torch
from torch import Tensor

from render.errors import ParameterError
from render.media.layer import Number, check_layer
from render.media.special_functions import exponential_moment, log_ratio, scaled_erfc
from render.media.sphere import curvature, shadowed

SERIES_RATIO = -0.5
"""Ratio of depths below which a descent is inverted through logarithms of extinctions, which cannot underflow."""


@dataclass(frozen=True, eq=False)
class ExponentialDecay:
    """Layer whose extinction falls by e in each scale height; haze, and the height fog of games.

    sigma(h) = sigma_0 exp(-(h - reference) / H). Velinov, "Various analytic expressions for collimated light
    scattered in fog", prints beta' = beta and alpha' = alpha for this medium. Along a ray of slope v from a height
    h_0 the exponent falls at beta' = beta v, and the extinction begins at alpha' = alpha exp(-beta (h_0 -
    reference)). The inverse of its cumulative distribution is printed with the constant -D where the equation asks
    for +D. Here every quotient is an entire function of v: looking level is no special case.

    Args:
        extinction: sigma_0 at the reference height [1/m].
        scale_height: H [m].
        base: lower border [m]; minus infinity for fog that goes on downwards.
        reference: height at which `extinction` holds [m].

    Raises:
        ParameterError: for an extinction that is negative or not finite, or a scale height that is not positive and finite.
    """

    extinction: Number
    scale_height: Number
    base: Number = 0.0
    reference: Number = 0.0

    def __post_init__(self) -> None:
        check_layer("exponential fog", self.extinction, self.base, self.top)
        height = torch.as_tensor(self.scale_height)
        if not bool((torch.isfinite(height) & (height > 0.0)).all()):
            raise ParameterError(f"exponential fog: expected a positive scale height, got {self.scale_height} m")

    @property
    def top(self) -> float:
        """There is none [m]."""
        return float("inf")

    @property
    def datum(self) -> Number:
        """The reference height [m]."""
        return self.reference

    def extinction_at(self, level: Tensor) -> Tensor:
        """Extinction [1/m] at a level [m]."""
        return self.extinction * torch.exp(-level / self.scale_height)

    def mean_extinction(self, first: Tensor, last: Tensor) -> Tensor:
        """Mean extinction [1/m] between two levels [m]: from the lower, denser end, so that nothing overflows."""
        lower = self.extinction_at(torch.minimum(first, last))
        return lower * exponential_moment((last - first).abs() / self.scale_height)

    def unbounded_depth(self, level: Tensor, slope: Tensor) -> Tensor:
        """H sigma(h) / v where the ray rises [1], else infinite where there is any fog."""
        extinction = self.extinction_at(level)
        rises = slope > 0.0
        upwards = extinction * self.scale_height / torch.where(rises, slope, 1.0)
        return torch.where(rises, upwards, torch.where(extinction > 0.0, float("inf"), 0.0))

    def invert_depth(self, level: Tensor, slope: Tensor, depth: Tensor) -> Tensor:
        """Distance [m] to an optical depth [1].

            tau = sigma (1 - exp(-v s / H)) H / v   =>   s = -(H / v) log(1 - y),   y = tau v / (sigma H)

        with the extinction sigma where the ray begins and its slope v: s = (tau / sigma) log_ratio(y).
        """
        extinction = self.extinction_at(level)
        fog = torch.where(extinction > 0.0, extinction, 1.0)
        y = depth * slope / (fog * self.scale_height)
        near = (slope >= 0.0) | ((extinction > 0.0) & (y > SERIES_RATIO))
        direct = depth / fog * log_ratio(torch.where(near, y, 0.0).clamp(max=1.0))
        # A camera far above the fog begins where the extinction underflows; its logarithm does not.
        falling = torch.where(near, -1.0, slope)
        reached = torch.where(near, 1.0, extinction - depth * falling / self.scale_height)
        foggy = self.extinction + torch.zeros_like(reached)
        foggy = torch.where(near, 1.0, torch.where(foggy > 0.0, foggy, 1.0))
        fall = self.scale_height * torch.log(reached / foggy) + level
        return torch.where(near, direct, -fall / falling)

    def curved_depth(self, level: Tensor, slope: Tensor, radius: float) -> Tensor:
        """Optical depth [1] from a level [m] to the sun over round ground.

            integral of sigma exp(-(l s + kappa s^2 / 2) / H) ds = sigma sqrt(pi H / (2 kappa)) erfcx(l / sqrt(2 kappa H))

        the Chapman function to first order in H / radius (Chapman 1931). Overhead kappa is 0 and the integral is sigma H.
        """
        level, slope = torch.broadcast_tensors(level, slope)
        hidden = shadowed(level, self.base - self.reference, slope, radius)
        slope = torch.where(hidden, 0.0, slope)
        kappa = curvature(slope, radius)
        bent = kappa > 0.0
        width = (2.0 * self.scale_height / torch.where(bent, kappa, 1.0)).sqrt()
        path = 0.5 * torch.pi**0.5 * width * scaled_erfc(slope * width / (2.0 * self.scale_height))
        path = torch.where(bent, path, self.scale_height * torch.ones_like(path))
        return torch.where(hidden, float("inf"), self.extinction_at(level) * path)
