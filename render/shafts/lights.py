"""Lights of a scene: the sun and point lights, and whether a point sees them."""

import math
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from render.camera import Vector
from render.errors import ParameterError
from render.media.sphere import EARTH_RADIUS
from render.shafts.air import Air
from render.shafts.fog_bank import Shades
from render.shafts.particles import Colour, check_colour

LOW_SUN = math.sin(math.radians(20.0))
"""Slope of the sun below which the ground counts as round; above it that changes less than 1e-3 of the light."""

TABLE_HEIGHTS = 1 << 14
"""Heights of the table of depths to the sun; its error falls with their square."""


SUN_RADIUS = math.radians(0.2666)
"""Of the disc of the sun as seen from the earth [rad]."""

MOST_SHADOW_POINTS = 256
"""Each has a shadow map."""


class Visibility(Protocol):
    """Which points a light reaches."""

    def look_up_lit(self, points: Tensor) -> Tensor:
        """Booleans `(...)` of points `(..., 3)` [m]."""


@dataclass(frozen=True)
class AlwaysLit:
    """Nothing stands in the way."""

    def look_up_lit(self, points: Tensor) -> Tensor:
        """True for every point `(..., 3)` [m]."""
        return torch.ones(points.shape[:-1], dtype=torch.bool, device=points.device)


@dataclass(frozen=True)
class Sun:
    """Parallel light.

    Args:
        direction: unit vector towards the sun [1].
        irradiance: above the air, on a plane that faces the sun, red, green and blue.
        round_ground: whether the light of a low sun comes over round ground; over flat ground that of a level sun never arrives.
        angular_radius: of its disc [rad], 0 to less than pi / 4; a single point has none.
        shadow_points: points of the disc that cast shadows, at least 1.

    Raises:
        ParameterError: for a direction that is not of unit length, light that is negative or not finite, or a disc that is none.
    """

    direction: Vector
    irradiance: Colour = (1.0, 1.0, 1.0)
    round_ground: bool = True
    angular_radius: float = SUN_RADIUS
    shadow_points: int = 1

    def __post_init__(self) -> None:
        check_colour("irradiance of the sun", self.irradiance)
        if not abs(math.hypot(*self.direction) - 1.0) < 1e-6:
            raise ParameterError(f"expected a unit vector towards the sun, got {self.direction}")
        if not 0.0 <= self.angular_radius < 0.25 * math.pi:
            raise ParameterError(f"expected a radius of the sun from 0 to pi / 4, got {self.angular_radius} rad")
        check_shadow_points(self.shadow_points)

    def compute_depth(self, air: Air, height: Tensor) -> Tensor:
        """Optical depth `(..., channel)` [1] from heights `(...)` [m] to the sun; infinite where the ground is in between."""
        slope = torch.tensor(self.direction[2], dtype=height.dtype, device=height.device)
        if not self.round_ground or self.direction[2] >= LOW_SUN:
            return air.compute_depth(height, slope)
        total = height[..., None] * 0.0 + height.new_zeros(3)
        for part in air.constituents:
            medium = part.medium
            base, top = (torch.as_tensor(border, dtype=height.dtype) for border in (medium.base, medium.top))
            level = torch.minimum(torch.maximum(height, base), top) - medium.datum
            grey = torch.where(height > top, 0.0, medium.curved_depth(level, slope, EARTH_RADIUS))[..., None]
            # A colour without a channel extinguishes nothing there, however far the sun has set.
            tinted = torch.where(torch.isinf(grey), math.inf, grey * grey.new_tensor(part.colour))
            total = total + tinted
        return total


@dataclass(frozen=True)
class PointLight:
    """A small bright sphere.

    Its irradiance at a distance d is intensity / (d^2 + radius^2) w(d): the inverse square, kept finite within the sphere, and a
    window w = max(0, 1 - (d / reach)^4)^2 that takes it to nothing at `reach`.

    Args:
        position: of its centre [m].
        intensity: power per solid angle, red, green and blue.
        radius: of the sphere [m], positive.
        reach: distance beyond which there is no light [m]; infinite for none.
        shadow_points: points of the sphere that cast shadows, at least 1; one is its centre.

    Raises:
        ParameterError: for a position that is not finite, light that is negative or not finite, or a size that is not positive.
    """

    position: Vector
    intensity: Colour
    radius: float = 0.05
    reach: float = math.inf
    shadow_points: int = 1

    def __post_init__(self) -> None:
        check_shadow_points(self.shadow_points)
        check_colour("intensity of a point light", self.intensity)
        if not all(math.isfinite(part) for part in self.position):
            raise ParameterError(f"expected a finite position of a point light, got {self.position}")
        if not (0.0 < self.radius < math.inf and self.reach > 0.0):
            raise ParameterError(
                f"expected a positive radius and reach of a point light, got {self.radius} m and {self.reach} m"
            )

    def window(self, distance: Tensor) -> Tensor:
        """Share of the light [1] that is left of the inverse square at distances `(...)` [m]."""
        return (1.0 - (distance / self.reach) ** 4).clamp(min=0.0).square()


def check_shadow_points(count: int) -> None:
    """Raise ParameterError for a number of points of a light that cannot be."""
    if not 1 <= count <= MOST_SHADOW_POINTS:
        raise ParameterError(
            f"expected from 1 to {MOST_SHADOW_POINTS} points that cast the shadow of a light, got {count}"
        )


@dataclass(frozen=True, eq=False)
class SunDepthTable:
    """Optical depth to the sun over height.

    Args:
        lowest: first height [m].
        spacing: between heights [m].
        depths: `(height, channel)` [1]; held at the ends.
    """

    lowest: float
    spacing: float
    depths: Tensor

    def look_up(self, height: Tensor) -> Tensor:
        """Depth `(..., channel)` [1] at heights `(...)` [m], interpolated."""
        place = ((height.double() - self.lowest) / self.spacing).clamp(0.0, len(self.depths) - 1.0)
        cell = place.long().clamp(max=len(self.depths) - 2)
        share = (place - cell)[..., None].to(height.dtype)
        depths = self.depths.to(height.dtype)
        near, far = depths[cell], depths[cell + 1]
        # Next to the shadow of the ground one end is infinite, and infinity times 0 is no number.
        bounded = near + share * (far - near)
        return torch.where(torch.isinf(near) | torch.isinf(far), torch.maximum(near, far), bounded)


def build_sun_depth(air: Air, sun: Sun, lowest: float, highest: float, heights: int = TABLE_HEIGHTS) -> SunDepthTable:
    """Fill the table between two heights.

    Args:
        air: what the light passes.
        sun: where it comes from.
        lowest, highest: [m].
        heights: number of heights, at least 2.

    Returns:
        The table, float64.
    """
    if highest <= lowest:
        highest = lowest + 1.0
    spacing = (highest - lowest) / (heights - 1)
    levels = lowest + spacing * torch.arange(heights, dtype=torch.float64)
    return SunDepthTable(lowest, spacing, sun.compute_depth(air, levels))


@dataclass(frozen=True, eq=False)
class SunInScene:
    """The sun with what the march asks about it: depth of the layers, what casters and what banks of fog leave of it."""

    light: Sun
    depth: SunDepthTable
    visibility: Visibility
    shades: Shades = ()


@dataclass(frozen=True, eq=False)
class PointInScene:
    """A point light with the points that it reaches, and what banks of fog leave of it."""

    light: PointLight
    visibility: Visibility
    shades: Shades = ()


@dataclass(frozen=True, eq=False)
class Lighting:
    """All lights of a march.

    Args:
        sun: or the first point of its disc, or None.
        points: point lights.
        more_suns: further points of the disc.
    """

    sun: SunInScene | None = None
    points: tuple[PointInScene, ...] = ()
    more_suns: tuple[SunInScene, ...] = ()

    @property
    def suns(self) -> tuple[SunInScene, ...]:
        """All points of the sun."""
        return () if self.sun is None else (self.sun, *self.more_suns)

    def separate(self) -> "list[Lighting]":
        """Each light by itself, the sun first."""
        return [Lighting(sun) for sun in self.suns] + [Lighting(points=(point,)) for point in self.points]

    @property
    def names(self) -> str:
        """What shines, in words."""
        parts = ["the sun"] if self.sun is not None else []
        if self.more_suns:
            parts = [f"{len(self.suns)} points of the sun"]
        if self.points:
            parts.append("one lamp" if len(self.points) == 1 else f"{len(self.points)} lamps")
        return " and ".join(parts) or "no light"
