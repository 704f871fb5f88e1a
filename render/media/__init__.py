"""Fog in closed form: layered media lit by the sun, their optical depth, in-scattered light and random flights."""

from collections.abc import Mapping
from types import MappingProxyType

from render.errors import ParameterError
from render.media.exponential_decay import ExponentialDecay
from render.media.free_flight import FlightDistribution
from render.media.height_fog import (
    FogImage,
    FogLight,
    compose_fog,
    extinction_from_visibility,
    ground_distance,
)
from render.media.in_scattering import (
    compute_curved_in_scattering,
    compute_in_scattering,
    compute_section_in_scattering,
    compute_transmittance,
)
from render.media.layer import LayeredMedium, compute_optical_depth, find_distance
from render.media.linear_decay import LinearDecay
from render.media.uniform import Uniform

MEDIA: Mapping[str, type[Uniform] | type[LinearDecay] | type[ExponentialDecay]] = MappingProxyType(
    {"uniform": Uniform, "linear": LinearDecay, "exponential": ExponentialDecay}
)
"""The media by name. Each takes an extinction [1/m] at its base and a height [m]: that of its top, or its scale height."""


def find_medium(name: str) -> type[Uniform] | type[LinearDecay] | type[ExponentialDecay]:
    """The medium of that name.

    Raises:
        ParameterError: when there is none.
    """
    if name not in MEDIA:
        raise ParameterError(f"no medium is called {name!r}; there are {', '.join(MEDIA)}")
    return MEDIA[name]


__all__ = [
    "MEDIA",
    "ExponentialDecay",
    "FlightDistribution",
    "FogImage",
    "FogLight",
    "LayeredMedium",
    "LinearDecay",
    "Uniform",
    "compose_fog",
    "compute_curved_in_scattering",
    "compute_in_scattering",
    "compute_optical_depth",
    "compute_section_in_scattering",
    "compute_transmittance",
    "extinction_from_visibility",
    "find_distance",
    "find_medium",
    "ground_distance",
]
