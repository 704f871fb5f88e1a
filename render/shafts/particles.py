"""What particles do with light, wherever they float: colour, albedo and phase function."""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Protocol

from torch import Tensor

from render.errors import ParameterError
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


class Particles(Protocol):
    """Particles of one kind; their `colour` are factors on the extinction, red, green and blue [1]."""

    @property
    def colour(self) -> Colour:
        """Factors on the extinction [1]."""

    @property
    def albedo(self) -> float:
        """Share of the extinguished light that is scattered, 0..1."""

    @property
    def phase(self) -> str:
        """A name of `PHASE_FUNCTIONS`."""

    @property
    def asymmetry(self) -> float:
        """Of the Henyey-Greenstein function."""

    def evaluate_phase(self, cosine: Tensor) -> Tensor:
        """Phase function [1/sr] of the cosine between view ray and direction to the light, any shape."""


def check_colour(name: str, colour: Colour) -> None:
    """Raise ParameterError unless a colour has three finite numbers of at least 0."""
    if len(colour) != 3 or not all(math.isfinite(part) and part >= 0.0 for part in colour):
        raise ParameterError(f"{name}: expected three finite numbers of at least 0, got {colour}")


def check_particles(particles: Particles) -> None:
    """Raise ParameterError for a colour, an albedo, a phase function or an asymmetry that cannot be."""
    check_asymmetry(particles.asymmetry)
    check_colour("the colour of an extinction", particles.colour)
    if not 0.0 <= particles.albedo <= 1.0:
        raise ParameterError(f"expected an albedo in 0..1, got {particles.albedo}")
    if particles.phase not in PHASE_FUNCTIONS:
        raise ParameterError(f"no phase function is called {particles.phase!r}; there are {', '.join(PHASE_FUNCTIONS)}")
