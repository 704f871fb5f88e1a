"""Fog of one extinction between two heights."""

from dataclasses import dataclass

import torch
from torch import Tensor

from render.media.layer import Number, check_layer, finite_or
from render.media.sphere import distance_to_top, shadowed


@dataclass(frozen=True, eq=False)
class Uniform:
    """Layer of constant extinction; a mixed layer of haze, or the air in front of a picture.

    Between the borders sigma(h) = sigma. Velinov, "Various analytic expressions for collimated light scattered in
    fog", prints the in-scattering of this medium without the factor 1 / (sigma c), c being the rate at which the
    exponent grows in units of the view's optical depth, and with t_B - d_S where t_B - t_S is meant. Both are plain
    from the units: as printed, a radiance grows with the unit of length.

    Args:
        extinction: sigma [1/m].
        top: upper border [m]; with an infinite one no sunlight arrives.
        base: lower border [m].

    Raises:
        ParameterError: for an extinction that is negative or not finite, or a base that is not below the top.
    """

    extinction: Number
    top: Number
    base: Number = 0.0

    def __post_init__(self) -> None:
        check_layer("uniform fog", self.extinction, self.base, self.top)

    @property
    def datum(self) -> Number:
        """The top, or else the base, or else 0 [m]."""
        return finite_or(self.top, finite_or(self.base, 0.0))

    def extinction_at(self, level: Tensor) -> Tensor:
        """Extinction [1/m] at a level [m] within the layer."""
        return self.extinction + torch.zeros_like(level)

    def mean_extinction(self, first: Tensor, last: Tensor) -> Tensor:
        """Mean extinction [1/m] between two levels [m]: the same everywhere."""
        return self.extinction + torch.zeros_like(first)

    def unbounded_depth(self, level: Tensor, slope: Tensor) -> Tensor:
        """Infinite where there is any fog [1]."""
        return torch.where(self.extinction_at(level) > 0.0, float("inf"), 0.0)

    def invert_depth(self, level: Tensor, slope: Tensor, depth: Tensor) -> Tensor:
        """Distance [m] to an optical depth [1]: depth / sigma."""
        extinction = self.extinction_at(level)
        return depth / torch.where(extinction > 0.0, extinction, 1.0)

    def curved_depth(self, level: Tensor, slope: Tensor, radius: float) -> Tensor:
        """Optical depth [1] from a level [m] to the sun over round ground: sigma times the distance to the top."""
        distance = distance_to_top(self.top - self.datum - level, slope, radius)
        return torch.where(
            shadowed(level, self.base - self.datum, slope, radius), float("inf"), self.extinction * distance
        )
