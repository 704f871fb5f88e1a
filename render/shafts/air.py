"""What fills the air of a scene: layers of molecules, haze and fog, each with its colour, albedo and phase function.

A constituent is a layered medium of `render.media` of one grey profile, times a colour. Its optical depths are those closed forms:
along the view ray, to the sun and to a point light. Several constituents share the space; their extinctions add up.
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from render.media import LayeredMedium, compute_optical_depth
from render.media.layer import Number
from render.shafts.fog_bank import FogBank
from render.shafts.particles import PHASE_FUNCTIONS, Colour, Particles, check_particles
from render.shafts.rays import ViewRays


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
        check_particles(self)

    def evaluate_phase(self, cosine: Tensor) -> Tensor:
        """Phase function [1/sr] of the cosine between view ray and direction to the light, any shape."""
        return PHASE_FUNCTIONS[self.phase](cosine, self.asymmetry)

    def compute_depth(self, height: Number, slope: Number, distance: Number = math.inf) -> Tensor:
        """Optical depth (..., channel) [1] of rays from heights [m], of slopes [1] and lengths [m], each (...)."""
        grey = compute_optical_depth(self.medium, height, slope, distance)
        return grey[..., None] * grey.new_tensor(self.colour)

    def compute_extinction(self, height: Tensor) -> Tensor:
        """Extinction `(..., channel)` [1/m] at heights `(...)` [m]."""
        medium = self.medium
        inside = (height >= medium.base) & (height <= medium.top)
        within = torch.where(inside, height, torch.as_tensor(medium.datum, dtype=height.dtype)) - medium.datum
        grey = torch.where(inside, medium.extinction_at(within), 0.0)
        return grey[..., None] * grey.new_tensor(self.colour)


@dataclass(frozen=True)
class Air:
    """All that fills the air of a scene.

    Args:
        constituents: level layers; none is a vacuum.
        banks: fog that has a place.
    """

    constituents: tuple[Constituent, ...] = ()
    banks: tuple[FogBank, ...] = ()

    @property
    def particles(self) -> tuple[Particles, ...]:
        """Whatever scatters: the constituents, then the banks."""
        return (*self.constituents, *self.banks)

    @property
    def empty(self) -> bool:
        """Whether there is nothing that scatters or absorbs."""
        return all(bank.empty for bank in self.banks) and all(
            not any(part.colour) or not bool((torch.as_tensor(_extinction(part)) > 0.0).any())
            for part in self.constituents
        )

    def at_time(self, time: float) -> "Air":
        """The same air with its banks at another time [s]."""
        return replace(self, banks=tuple(bank.at_time(time) for bank in self.banks))

    def compute_depth(self, height: Tensor, slope: Tensor, distance: Number = math.inf) -> Tensor:
        """Optical depth of the layers along rays, that of banks left out.

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

    def compute_ray_depths(self, rays: ViewRays) -> tuple[Tensor, Tensor]:
        """Optical depth of view rays through layers and banks, and the part of it that is scattered, each `(ray, channel)` [1]."""
        height, slope = rays.origin[:, 2], rays.direction[:, 2]
        total = scattered = height.new_zeros(len(rays), 3)
        for part in self.constituents:
            depth = part.compute_depth(height, slope, rays.distance)
            total, scattered = total + depth, scattered + part.albedo * depth
        for bank in self.banks:
            depth = bank.compute_ray_depth(rays)
            total, scattered = total + depth, scattered + bank.albedo * depth
        return total, scattered


def _extinction(part: Constituent) -> Number:
    return getattr(part.medium, "extinction", 1.0)
