"""Fog, smoke and haze made of pseudo-spheroids that drift and change: density as a function of place and time.

After Tan et al. 2020, "Adaptive volumetric light and atmospheric scattering" (interactive estimation of the density of
participating media): spheroids with normally distributed centres, and radii perturbed by noise.

    c_k(t) = m + S n_k + u t                                       centres; n_k three standard normal numbers
    R_k(w, t) = r_k (1 + a N((r_k w + S n_k) / l + t e / T))       radius in the direction w from the centre
    density = strength h(z) f(x, y) (1 - product over k of (1 - p(1 - |x - c_k| / R_k)))

where m is the middle of the medium, S its spread, u the wind, N the noise of `render.shafts.solid_noise`, a its amplitude and l
its wavelength, T the time in which shapes change, e a fixed direction, and p(d) = d^2 (3 - 2 d) within 0..1. Vertical distances from a
centre count 1 / flattening times. The densities of overlapping spheroids combine like the shares that two screens hide, so that
they never exceed 1. Above its base the medium thins as h = exp(-(z - base) / scale height), and outwards as
f = exp(-(x^2 + y^2) / (2 extent^2)) around the wind-borne middle. The noise belongs to the air that drifts, so wind alone does not
change shapes.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from render.camera import Vector
from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.random_streams import child_generator
from render.shafts.solid_noise import SolidNoise

POINTS_IN_FLIGHT = 1 << 18
"""Points evaluated at once: bounds the memory."""

# Stages of the random streams: one keeps its numbers when another draws more.
_CENTRES, _RADII, _NOISE = range(3)

# Any direction that is along no axis of the noise's lattice.
_EVOLUTION = (0.61, 0.53, 0.59)


@dataclass(frozen=True)
class SpheroidMedium:
    """A heap of pseudo-spheroids.

    Args:
        middle: where the centres scatter around at time 0 [m].
        spread: standard deviation of the centres along x, y and z [m].
        count: number of spheroids.
        radius: mean radius [m].
        radius_variation: radii are uniform within this part of the mean on either side, 0 to less than 1.
        flattening: vertical over horizontal radius.
        noise_amplitude: largest perturbation of a radius over the radius, 0 to less than 1.
        noise_wavelength: of the longest bumps [m].
        scale_height: height above the base in which the density falls by e [m]; infinite for none.
        base: height of the ground of the medium [m]; below it there is nothing.
        extent: horizontal distance at which the density has fallen to exp(-1/2) [m]; infinite for none.
        wind: velocity [m/s].
        change_time: in which shapes move by one wavelength of the noise [s]; infinite for none.
        seed: of positions, radii and noise.

    Raises:
        ParameterError: for a number outside its domain.
    """

    middle: Vector
    spread: Vector
    count: int
    radius: float
    radius_variation: float = 0.3
    flattening: float = 0.6
    noise_amplitude: float = 0.4
    noise_wavelength: float = 10.0
    scale_height: float = math.inf
    base: float = -math.inf
    extent: float = math.inf
    wind: Vector = (0.0, 0.0, 0.0)
    change_time: float = math.inf
    seed: int = 0

    def __post_init__(self) -> None:
        finite = all(math.isfinite(number) for number in (*self.middle, *self.spread, *self.wind))
        if not finite or min(self.spread) < 0.0 or self.count < 0 or self.seed < 0:
            raise ParameterError(f"a medium needs finite places, a spread, a count and a seed of at least 0: {self}")
        lengths = (self.radius, self.noise_wavelength, self.flattening)
        if not all(0.0 < length < math.inf for length in lengths):
            raise ParameterError(f"radius, flattening and wavelength must be positive and finite: {self}")
        if not all(length > 0.0 for length in (self.scale_height, self.extent, self.change_time)):
            raise ParameterError(f"scale height, extent and time of change must be positive: {self}")
        if not all(0.0 <= part < 1.0 for part in (self.radius_variation, self.noise_amplitude)):
            raise ParameterError(f"variations must be at least 0 and less than 1: {self}")
        if math.isinf(self.base) and not math.isinf(self.scale_height):
            raise ParameterError("a medium that thins with height needs a base from which to count")

    @cached_property
    def offsets(self) -> Tensor:
        """Centres relative to the middle `(spheroid, 3)` [m]."""
        normal = torch.randn(self.count, 3, generator=child_generator(self.seed, _CENTRES))
        return normal * torch.tensor(self.spread)

    @cached_property
    def radii(self) -> Tensor:
        """Unperturbed horizontal radii `(spheroid,)` [m]."""
        uniform = 2.0 * torch.rand(self.count, generator=child_generator(self.seed, _RADII)) - 1.0
        return self.radius * (1.0 + self.radius_variation * uniform)

    @cached_property
    def noise(self) -> SolidNoise:
        """The noise that perturbs the radii."""
        return SolidNoise(self.seed + _NOISE)

    def bounds(self, time: float = 0.0) -> tuple[Tensor, Tensor]:
        """Corners `(3,)` of a box outside of which the density is zero at a time [s]; [m].

        Raises:
            ParameterError: for a medium without spheroids or wholly below its base, which has no box.
        """
        reach = (1.0 + self.noise_amplitude) * self.radii[:, None] * torch.tensor([1.0, 1.0, self.flattening])
        places = self._middle_at(time) + self.offsets
        if self.count:
            lower, upper = (places - reach).amin(0), (places + reach).amax(0)
            lower[2] = max(float(lower[2]), self.base)
            if bool((upper > lower).all()):
                return lower, upper
        raise ParameterError("a medium without spheroids above its base fills no box; leave it out")

    def evaluate_density(self, points: Tensor, time: float = 0.0, strength: float = 1.0) -> Tensor:
        """Density at points.

        Args:
            points: positions `(point, 3)` [m].
            time: [s].
            strength: the user's control, a factor of at least 0.

        Returns:
            Densities from 0 to `strength` `(point,)` [1], computed in float32.

        Raises:
            ParameterError: for a time that is not finite or a strength that is negative or not finite.
        """
        if not (math.isfinite(time) and 0.0 <= strength < math.inf):
            raise ParameterError(f"a medium needs a finite time and strength, not {time} s and {strength}")
        chunks = [strength * self._density(chunk, time) for chunk in points.to(torch.float32).split(POINTS_IN_FLIGHT)]
        return torch.cat(chunks).to(points.dtype)

    def _middle_at(self, time: float) -> Tensor:
        return torch.tensor([middle + time * wind for middle, wind in zip(self.middle, self.wind, strict=True)])

    def _density(self, points: Tensor, time: float) -> Tensor:
        carried = points - self._middle_at(time).to(points)
        clear = torch.ones_like(carried[:, 0])
        change = (time / self.change_time) * torch.tensor(_EVOLUTION, dtype=points.dtype)
        for offset, radius in zip(self.offsets.to(points), self.radii.tolist(), strict=True):
            away = (carried - offset) / torch.tensor([1.0, 1.0, self.flattening], dtype=points.dtype)
            distance = torch.linalg.vector_norm(away, dim=1)
            near = torch.nonzero(distance < (1.0 + self.noise_amplitude) * radius)[:, 0]
            away, distance = away[near], distance[near]
            direction = away / torch.where(distance > 0.0, distance, 1.0)[:, None]
            bumps = self.noise.look_up((radius * direction + offset) / self.noise_wavelength + change)
            surface = radius * (1.0 + self.noise_amplitude * bumps.clamp(-1.0, 1.0))
            depth = (1.0 - distance / surface).clamp(min=0.0)
            clear[near] *= 1.0 - depth * depth * (3.0 - 2.0 * depth)
        height = points[:, 2] - self.base if math.isfinite(self.base) else torch.zeros_like(clear)
        outwards = carried[:, :2].square().sum(1) / (2.0 * self.extent * self.extent)
        falling = torch.exp(-height.clamp(min=0.0) / self.scale_height - outwards)
        return torch.where(height >= 0.0, (1.0 - clear) * falling, 0.0)


def build_medium_grid(medium: SpheroidMedium, resolution: int, time: float = 0.0, strength: float = 1.0) -> DensityGrid:
    """Density of a medium on a grid just around it: as fast to look up for a thousand spheroids as for one.

    Args:
        medium: with at least one spheroid.
        resolution: voxels along the longest side, 1 to 1024.
        time: [s].
        strength: the user's control.

    Returns:
        The grid at that time.

    Raises:
        ParameterError: for a resolution outside its bounds, or a medium that fills no box.
    """
    if not 1 <= resolution <= 1024:
        raise ParameterError(f"a grid needs from 1 to 1024 voxels along a side, not {resolution}")
    lower, upper = medium.bounds(time)
    voxel = float((upper - lower).max()) / resolution
    counts = torch.ceil((upper - lower) / voxel - 1e-3).long().clamp(min=1)
    size = (upper - lower) / counts
    axes = [lower[axis] + (torch.arange(int(counts[axis])) + 0.5) * size[axis] for axis in (2, 1, 0)]
    z, y, x = torch.meshgrid(*axes, indexing="ij")
    density = medium.evaluate_density(torch.stack([x, y, z], dim=-1).reshape(-1, 3), time, strength)
    return DensityGrid(density.reshape(x.shape), lower, upper)
