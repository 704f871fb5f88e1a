"""The two kinds of losses: those that compare histograms, and those that need the pixels themselves.

Both are numbers to be made small, and both are called with what a rendering shows and what the photograph shows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from render.errors import ParameterError


@dataclass(frozen=True)
class Loss:
    """A distance between histograms: what to compute, its best value and its worst.

    Args:
        name: key in `LOSSES`.
        optimum: value for two equal histograms.
        worst: bound that no two histograms exceed; infinite where there is none.
        unit: unit of the value.
        distance: (..., bin) and (..., bin), broadcast, in float64 -> (...).
    """

    name: str
    optimum: float
    worst: float
    unit: str
    distance: Callable[[Tensor, Tensor], Tensor]

    is_differentiable: ClassVar[bool] = False
    """A histogram of whole pixels moves in steps: its gradient is zero wherever there is one."""

    def __call__(self, histogram: Tensor, target: Tensor) -> Tensor:
        """Distance of each histogram from the target's; a histogram with NaN has the loss NaN.

        Args:
            histogram: (..., bin), each sums to 1.
            target: (..., bin), leading dimensions that broadcast against those of `histogram`.

        Returns:
            (...) float64 [unit]. The mean over channels is the caller's.

        Raises:
            ParameterError: when the shapes do not fit each other.
        """
        try:
            torch.broadcast_shapes(histogram.shape, target.shape)
            same_bins = histogram.ndim > 0 and target.ndim > 0 and histogram.shape[-1] == target.shape[-1]
        except RuntimeError:
            same_bins = False
        if not same_bins:
            raise ParameterError(
                f"{self.name}: expected two histograms (..., bin) with as many bins and leading dimensions that "
                f"broadcast, got {tuple(histogram.shape)} and {tuple(target.shape)}"
            )
        return self.distance(histogram.double(), target.double())


@dataclass(frozen=True, eq=False)
class PhotographValues:
    """Display values 0..1 of a photograph, as a loss of pixels may need them.

    Args:
        cloud: its cloud pixels in any order `(channel, sample)`.
        in_place: the photograph resized to the rendering, at the rendering's counted pixels `(channel, pixel)`.
    """

    cloud: Tensor
    in_place: Tensor


@dataclass(frozen=True)
class StandIn:
    """A distance of histograms that chooses the air in place of a distance of pixels, because levels are counted fast.

    Args:
        loss: the distance.
        is_soft: whether of soft histograms, with the target of the loss itself, or of ordinary ones.
    """

    loss: Loss
    is_soft: bool


@dataclass(frozen=True)
class PixelLoss:
    """A distance between the pixels of a rendering and a photograph, differentiable in the rendering's.

    Args:
        name: key in `LOSSES`.
        optimum: value for two equal images.
        worst: bound that no two images exceed.
        unit: unit of the value.
        target_size: name of the target's last dimension, "pixel" or "bin".
        is_paired: whether each pixel is compared with the one in its place, so that shuffling matters.
        prepare: the photograph's values -> target (channel, target_size), once for many renderings.
        distance: display values 0..1 (..., channel, pixel) and target -> (..., channel) float64.
        air_stand_in: what chooses the air in its place, or None.
    """

    name: str
    optimum: float
    worst: float
    unit: str
    target_size: str
    is_paired: bool
    prepare: Callable[[PhotographValues], Tensor]
    distance: Callable[[Tensor, Tensor], Tensor]
    air_stand_in: StandIn | None = None

    is_differentiable: ClassVar[bool] = True

    def __call__(self, values: Tensor, target: Tensor) -> Tensor:
        """Distance of each image from the photograph's; an image with NaN has the loss NaN in that channel.

        Args:
            values: display values 0..1 (..., channel, pixel), in float32 or float64.
            target: (channel, target_size), from `prepare`.

        Returns:
            (..., channel) float64 [unit]. The mean over channels is the caller's.

        Raises:
            ParameterError: when the shapes do not fit each other.
        """
        fits = values.ndim >= 2 and target.ndim == 2 and values.shape[-2] == target.shape[0] and values.shape[-1] > 0
        if not fits or (self.target_size == "pixel" and values.shape[-1] != target.shape[-1]):
            raise ParameterError(
                f"{self.name}: expected values (..., channel, pixel) and a target (channel, {self.target_size}) that fits them, "
                f"got {tuple(values.shape)} and {tuple(target.shape)}"
            )
        return self.distance(values, target)


AnyLoss = Loss | PixelLoss
