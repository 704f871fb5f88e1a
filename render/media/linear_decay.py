"""Fog that thins out evenly from its base to nothing at its top."""

from dataclasses import dataclass

import torch
from torch import Tensor

from render.media.layer import Number, check_layer
from render.media.sphere import distance_to_top, shadowed


@dataclass(frozen=True, eq=False)
class LinearDecay:
    """Layer whose extinction falls linearly to zero; radiation fog over a meadow.

    sigma(h) = sigma_0 (top - h) / (top - base). The optical depth of a stretch of a ray is quadratic in its length;
    as the length times the mean of the extinctions at its ends nothing cancels, and a level ray is no special case.

    Args:
        extinction: sigma_0, at the base [1/m].
        top: height at which the fog ends [m], finite.
        base: lower border [m], finite.

    Raises:
        ParameterError: for an extinction that is negative or not finite, borders in the wrong order or not finite.
    """

    extinction: Number
    top: Number
    base: Number = 0.0

    def __post_init__(self) -> None:
        check_layer("linear fog", self.extinction, self.base, self.top, finite=True)

    @property
    def gradient(self) -> Number:
        """Extinction gained per metre of descent [1/m^2]."""
        return self.extinction / (self.top - self.base)

    @property
    def datum(self) -> Number:
        """The top [m], where there is no fog."""
        return self.top

    def extinction_at(self, level: Tensor) -> Tensor:
        """Extinction [1/m] at a level [m] within the layer."""
        return -self.gradient * level

    def mean_extinction(self, first: Tensor, last: Tensor) -> Tensor:
        """Mean extinction [1/m] between two levels [m]: that of the two."""
        return 0.5 * (self.extinction_at(first) + self.extinction_at(last))

    def unbounded_depth(self, level: Tensor, slope: Tensor) -> Tensor:
        """Infinite where there is any fog [1]: only a level ray does not leave it."""
        return torch.where(self.extinction_at(level) > 0.0, float("inf"), 0.0)

    def invert_depth(self, level: Tensor, slope: Tensor, depth: Tensor) -> Tensor:
        """Distance [m] to an optical depth [1].

            sigma s - G v s^2 / 2 = tau   =>   s = 2 tau / (sigma + sqrt(sigma^2 - 2 G v tau))

        with the extinction sigma where the ray begins, the gradient G and the slope v. The other root lies beyond the top.
        """
        extinction = self.extinction_at(level)
        square = extinction.square() - 2.0 * self.gradient * slope * depth
        positive = square > 0.0
        total = extinction + torch.where(positive, torch.where(positive, square, 1.0).sqrt(), 0.0)
        return 2.0 * depth / torch.where(total > 0.0, total, 1.0)

    def curved_depth(self, level: Tensor, slope: Tensor, radius: float) -> Tensor:
        """Optical depth [1] from a level [m] to the sun over round ground.

        The ray rises by l s + kappa s^2 / 2 in a distance s. With the distance S to the top, which lies D above,
        the integral of G (D - l s - kappa s^2 / 2) from 0 to S is G S (2 D / 3 - l S / 6) = G S (D / 2 + kappa S^2 / 12).
        """
        above = -level
        distance = distance_to_top(above, slope, radius)
        depth = self.gradient * distance * (2.0 / 3.0 * above - slope * distance / 6.0)
        return torch.where(shadowed(level, self.base - self.top, slope, radius), float("inf"), depth)
