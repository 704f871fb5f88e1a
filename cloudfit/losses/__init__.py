"""Losses between a rendering and a photograph, each to be made small: one registry, whichever kind they are."""

from collections.abc import Mapping
from types import MappingProxyType

from cloudfit.losses.floor import flat_l1_floor, l1_floor, sampled_floor
from cloudfit.losses.histogram import HISTOGRAM_LOSSES, L1, l1_distance, wasserstein_distance
from cloudfit.losses.kinds import AnyLoss, Loss, PhotographValues, PixelLoss
from cloudfit.losses.soft_histogram import SOFT_L1
from cloudfit.losses.sorted_quantiles import SORTED_WASSERSTEIN
from cloudfit.losses.squared_difference import SQUARED_DIFFERENCE
from render.errors import ParameterError

LOSSES: Mapping[str, AnyLoss] = MappingProxyType(
    {loss.name: loss for loss in (*HISTOGRAM_LOSSES, SQUARED_DIFFERENCE, SOFT_L1, SORTED_WASSERSTEIN)}
)

DEFAULT_LOSS = "l1"


def find_loss(name: str) -> AnyLoss:
    """The loss of that name.

    Raises:
        ParameterError: when there is none.
    """
    if name not in LOSSES:
        raise ParameterError(f"no loss is called {name!r}; there are {', '.join(LOSSES)}")
    return LOSSES[name]


__all__ = [
    "DEFAULT_LOSS",
    "L1",
    "LOSSES",
    "AnyLoss",
    "Loss",
    "PhotographValues",
    "PixelLoss",
    "find_loss",
    "flat_l1_floor",
    "l1_distance",
    "l1_floor",
    "sampled_floor",
    "wasserstein_distance",
]
