"""What fills the air of a scene: layers of molecules, haze and fog, each with its colour, albedo and phase function.

A constituent is a layered medium of `render.media` of one grey profile, times a colour. Its optical depths are those closed forms:
along the view ray, to the sun and to a point light. Several constituents share the space; their extinctions add up.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import torch
from torch import Tensor

from render.errors import ParameterError
from render.media import LayeredMedium, compute_optical_depth
from render.media.layer import Number
from render.phase_functions import check_asymmetry, evaluate_phase_function
from render.rayleigh_phase import evaluate_rayleigh_phase

Colour = tuple[float, float, float]

PHASE_FUNCTIONS: Mapping[str, Callable[[Tensor, float], Tensor]] = MappingProxyType(
    {
        "rayleigh": lambda cosine, _: evaluate_rayleigh_phase(cosine),
        "henyey_greenstein": evaluate_phase_function,
    }
)
"""Phase functions by name: cosine (any shape) and asymmetry to values [1/sr]. The first takes no notice of the asymmetry."""


@dataclass(frozen=True, eq=False)
class Constituent:
    """One kind of particle.

    Args:
        medium: its grey profile; extinction in [1/m].
        colour: factors on the extinction, red, green and blue [1].
        albedo: share of the extinguished light that is scattered, 0..1.
        phase: a name of `PHASE_FUNCTIONS`.
        asymmetry: of the Henyey-Greenstein function.

    Raises:
        ParameterError: for a colour that is negative or not finite, an albedo outside 0..1, or another phase function.
    """

    medium: LayeredMedium
    colour: Colour = (1.0, 1.0, 1.0)
    albedo: float = 1.0
    phase: str = "henyey_greenstein"
    asymmetry: float = 0.0

    def __post_init__(self) -> None:
        check_asymmetry(self.asymmetry)
        check_colour("the colour of an extinction", self.colour)
        if not 0.0 <= self.albedo <= 1.0:
            raise ParameterError(f"expected an albedo in 0..1, got {self.albedo}")
        if self.phase not in PHASE_FUNCTIONS:
            raise ParameterError(f"no phase function is called {self.phase!r}; there are {', '.join(PHASE_FUNCTIONS)}")

    def evaluate_phase(self, cosine: Tensor) -> Tensor:
        """Phase function [1/sr] of the cosine between view ray and direction to the light, any shape."""
        return PHASE_FUNCTIONS[self.phase](cosine, self.asymmetry)

    def compute_depth(self, height: Number, slope: Number, distance: Number = math.inf) -> Tensor:
        """Optical depth (..., channel) [1] of rays from heights [m], of slopes [1] and lengths [m], each (...)."""
        grey = compute_optical_depth(self.medium, height, slope, distance)
        return grey[..., None] * grey.new_tensor(self.colour)


@dataclass(frozen=True)
class Air:
    """All constituents of the air; none is a vacuum."""

    constituents: tuple[Constituent, ...] = ()

    @property
    def empty(self) -> bool:
        """Whether there is nothing that scatters or absorbs."""
        return all(
            not any(part.colour) or not bool((torch.as_tensor(_extinction(part)) > 0.0).any())
            for part in self.constituents
        )

    def compute_depth(self, height: Tensor, slope: Tensor, distance: Number = math.inf) -> Tensor:
        """Optical depth of rays.

        Args:
            height: where they begin `(...)` [m].
            slope: vertical components of their unit directions [1], broadcast.
            distance: their lengths [m], broadcast; may be infinite.

        Returns:
            Depth `(..., channel)` [1].
        """
        total = (height + slope)[..., None] * height.new_zeros(3)
        for part in self.constituents:
            total = total + part.compute_depth(height, slope, distance)
        return total

    def mean_albedo(self, height: Tensor, slope: Tensor, distance: Tensor) -> Tensor:
        """Albedo `(ray, channel)` [1] of what rays `(ray,)` meet, weighted by optical depth; 0 where they meet nothing."""
        scattered = total = height.new_zeros(len(slope), 3)
        for part in self.constituents:
            depth = part.compute_depth(height, slope, distance)
            scattered, total = scattered + part.albedo * depth, total + depth
        return torch.where(total > 0.0, scattered / torch.where(total > 0.0, total, 1.0), 0.0)


def check_colour(name: str, colour: Colour) -> None:
    """Raise ParameterError unless a colour has three finite numbers of at least 0."""
    if len(colour) != 3 or not all(math.isfinite(part) and part >= 0.0 for part in colour):
        raise ParameterError(f"{name}: expected three finite numbers of at least 0, got {colour}")


def _extinction(part: Constituent) -> Number:
    return getattr(part.medium, "extinction", 1.0)
