"""A bank of fog in a scene: a medium that has a place and a time, what its particles do, and the shadow that it casts.

Beside the layers of the air, whose depths are closed forms, a bank is a grid of densities. A step of a ray takes from it the density in its
middle,

    dtau = extinction density(middle) length

and light that comes through it is dimmed by exp(-extinction L), with L the optical length from `render.shafts.self_shadowing`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.shafts.participating_media import SpheroidMedium, build_medium_grid
from render.shafts.particles import PHASE_FUNCTIONS, Colour, check_particles
from render.shafts.rays import ViewRays
from render.shafts.self_shadowing import Light, LightLengths, build_light_lengths, compute_length_along


@dataclass(frozen=True, eq=False)
class FogBank:
    """Fog with a place.

    Args:
        medium: spheroids, or a grid of densities that does not change with time.
        extinction: at density 1 [1/m].
        colour: factors on the extinction, red, green and blue [1].
        albedo: share of the extinguished light that is scattered, 0..1.
        phase: a name of `PHASE_FUNCTIONS`.
        asymmetry: of the Henyey-Greenstein function.
        strength: the user's control, a factor on the density of at least 0.
        time: for which spheroids are evaluated [s].
        resolution: voxels along the longest side of a grid of spheroids, 1 to 1024.
        shadow: whether the bank dims the light that reaches itself, the air around it, and surfaces.

    Raises:
        ParameterError: for a number outside its domain, or a medium that fills no box.
    """

    medium: SpheroidMedium | DensityGrid
    extinction: float
    colour: Colour = (1.0, 1.0, 1.0)
    albedo: float = 1.0
    phase: str = "henyey_greenstein"
    asymmetry: float = 0.0
    strength: float = 1.0
    time: float = 0.0
    resolution: int = 64
    shadow: bool = True

    def __post_init__(self) -> None:
        check_particles(self)
        for name, number in (("extinction", self.extinction), ("strength", self.strength)):
            if not 0.0 <= number < math.inf:
                raise ParameterError(f"expected a finite {name} of at least 0 of a bank of fog, got {number}")
        if not math.isfinite(self.time):
            raise ParameterError(f"expected a finite time of a bank of fog, got {self.time} s")
        if not 1 <= self.resolution <= 1024:
            raise ParameterError(f"expected from 1 to 1024 voxels along a bank of fog, got {self.resolution}")
        if isinstance(self.medium, SpheroidMedium):
            self.medium.bounds(self.time)

    @cached_property
    def grid(self) -> DensityGrid:
        """Density at the time of the bank [1]."""
        if isinstance(self.medium, SpheroidMedium):
            return build_medium_grid(self.medium, self.resolution, self.time, self.strength)
        return DensityGrid(self.strength * self.medium.density, self.medium.lower, self.medium.upper)

    @property
    def empty(self) -> bool:
        """Whether there is nothing that scatters or absorbs."""
        return self.extinction == 0.0 or self.strength == 0.0 or not any(self.colour)

    def at_time(self, time: float) -> "FogBank":
        """The same bank at another time [s]."""
        return replace(self, time=time)

    def evaluate_phase(self, cosine: Tensor) -> Tensor:
        """Phase function [1/sr] of the cosine between view ray and direction to the light, any shape."""
        return PHASE_FUNCTIONS[self.phase](cosine, self.asymmetry)

    def compute_depth(self, middles: Tensor, lengths: Tensor) -> Tensor:
        """Optical depth `(..., channel)` [1] of steps with middles `(..., 3)` [m] and lengths `(...)` [m]."""
        density = self.grid.look_up_density(middles.to(torch.float32)).to(lengths)
        return self.tint(density * lengths)

    def compute_ray_depth(self, rays: ViewRays) -> Tensor:
        """Optical depth `(ray, channel)` [1] of whole rays, by trapezoids of at most a voxel."""
        return self.tint(compute_length_along(self.grid, rays.origin, rays.direction, rays.distance, step=1.0))

    def tint(self, length: Tensor) -> Tensor:
        """Optical depth `(..., channel)` [1] of optical lengths `(...)` [m]."""
        return self.extinction * length[..., None] * length.new_tensor(self.colour)


Shades = tuple[LightLengths | None, ...]
"""Optical lengths to one light through each bank; None for a bank that casts no shadow. Without any there are no shadows of fog."""


def build_shades(banks: Sequence[FogBank], light: Light) -> Shades:
    """Tables of what each bank leaves of a light, in the order of the banks."""
    return tuple(build_light_lengths(bank.grid, light) if bank.shadow and not bank.empty else None for bank in banks)


def look_up_shade(banks: Sequence[FogBank], shades: Shades, points: Tensor) -> Tensor:
    """Optical depth of banks between points and a light.

    Args:
        banks: of the scene.
        shades: those of the light, one for each bank or none at all.
        points: `(..., 3)` [m].

    Returns:
        Depth `(..., channel)` [1].
    """
    total = torch.zeros_like(points)
    flat = points.reshape(-1, 3)
    for bank, lengths in zip(banks, shades, strict=False):
        if lengths is not None:
            total = total + bank.tint(lengths.look_up(flat)).reshape(points.shape)
    return total


def insert_bank_edges(rays: ViewRays, edges: Tensor, banks: Sequence[FogBank], steps: int) -> Tensor:
    """Borders of steps, and more of them within banks: equal parts of the way through the box of each.

    Args:
        rays: any number.
        edges: borders `(ray, step + 1)` [m], rising.
        banks: of the scene.
        steps: parts within each bank; 0 inserts nothing.

    Returns:
        `(ray, step + 1 + banks (steps + 1))` [m], rising; where a ray misses a bank the steps have no length.
    """
    if steps == 0 or not banks:
        return edges
    share = torch.arange(steps + 1, dtype=edges.dtype, device=edges.device) / steps
    inserted = [edges]
    for bank in banks:
        near, far = bank.grid.intersect(rays.origin.to(torch.float32), rays.direction.to(torch.float32))
        near, far = (torch.minimum(end.to(edges), rays.distance)[:, None] for end in (near, far))
        inserted.append(near + share * (far - near))
    return torch.cat(inserted, dim=1).sort(dim=1).values
