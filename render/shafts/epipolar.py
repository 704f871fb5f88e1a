"""Lines through the image of a light, along which shafts change slowly: where they run and where samples lie on them.

The shadow of anything in front of a light falls along lines that meet in the light's image, so scattered light varies fast
across these lines and slowly along them. Engelhardt & Dachsbacher 2010, "Epipolar sampling for shadows and crepuscular rays
in participating media with single scattering".

With the light at L = (X, Y) / w in the plane of the image, w >= 0, and N a length of its size, a line ends at a point E of
the image's border and its points are

    P = E - q v(E),   v(E) = (w E - (X, Y)) / N,   0 <= q <= N / w

which holds for a light at infinity too, w = 0. A light behind the camera has the same lines as the one opposite to it. v is
linear in E, so that between two neighbouring lines of one side of the border, points of equal q lie on a straight line: linear
interpolation in the fraction of the border and in q reproduces every linear function of the image.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from render.errors import ParameterError


@dataclass(frozen=True, eq=False)
class LightImage:
    """Image of a light and the frame it lights.

    Args:
        x, y, w: homogeneous coordinates in pixels: the light is seen at (x / w, y / w), column and row; w = 0 for a light at
            infinity in the plane of the image, in the direction (x, y); w < 0 for one behind the camera.
        width, height: pixel counts.

    Raises:
        ParameterError: if x, y and w are not finite or all zero, or the frame is empty.
    """

    x: float
    y: float
    w: float
    width: int
    height: int

    def __post_init__(self) -> None:
        largest = max(abs(self.x), abs(self.y), abs(self.w))
        if not 0.0 < largest < math.inf or math.isnan(self.x + self.y + self.w):
            raise ParameterError(
                f"the image of a light needs finite x, y, w, not all zero: {self.x}, {self.y}, {self.w}"
            )
        if self.width < 1 or self.height < 1:
            raise ParameterError(f"an image needs at least one pixel, not {self.width} x {self.height}")
        divisor = -largest if self.w < 0.0 else largest
        for name in ("x", "y", "w"):
            object.__setattr__(self, name, getattr(self, name) / divisor)

    @cached_property
    def scale(self) -> float:
        """N: the size of w E - (X, Y) somewhere in the frame, never zero."""
        middle = math.hypot(self.w * 0.5 * self.width - self.x, self.w * 0.5 * self.height - self.y)
        return middle + self.w * math.hypot(self.width, self.height)

    @cached_property
    def exit_sides(self) -> tuple["ExitSide", ...]:
        """Sides of the frame through which lines leave it, in the order left, right, top, bottom."""
        sides = []
        for axis, extent, across in ((0, self.width, self.height), (1, self.height, self.width)):
            light = (self.x, self.y)[axis]
            for border, leaves in ((0.0, light > 0.0), (float(extent), self.w * extent - light > 0.0)):
                if leaves:
                    sides.append(ExitSide(axis, border, float(across)))
        return tuple(sides)

    def outward(self, points: Tensor) -> Tensor:
        """v at points `(..., 2)` of the image, away from the light."""
        light = torch.tensor([self.x, self.y], dtype=points.dtype, device=points.device)
        return (self.w * points - light) / self.scale


@dataclass(frozen=True)
class ExitSide:
    """One side of the frame.

    Args:
        axis: 0 for a side of constant x, 1 for one of constant y.
        border: that constant [pixels].
        extent: length of the side [pixels].
    """

    axis: int
    border: float
    extent: float


@dataclass(frozen=True, eq=False)
class EpipolarLines:
    """Lines that end on the sides of the frame, evenly along each of them.

    Args:
        light: image of the light.
        sectors: number of gaps between lines on each of `light.exit_sides`; a side of n gaps has n + 1 lines.
    """

    light: LightImage
    sectors: tuple[int, ...]

    @property
    def lines(self) -> int:
        """Number of lines."""
        return sum(self.sectors) + len(self.sectors)

    @cached_property
    def ends(self) -> Tensor:
        """End of each line on the border `(line, 2)` x, y [pixels], float64."""
        parts = []
        for side, count in zip(self.light.exit_sides, self.sectors, strict=True):
            along = side.extent * torch.arange(count + 1, dtype=torch.float64) / count
            border = torch.full_like(along, side.border)
            parts.append(torch.stack([border, along] if side.axis == 0 else [along, border], dim=1))
        return torch.cat(parts)

    def points_at(self, line: Tensor, inward: Tensor) -> Tensor:
        """Points of the image at distances q `(...)` from the ends of lines `(...)`: `(..., 2)` x, y [pixels]."""
        end = self.ends.to(inward.device)[line]
        return end - inward[..., None] * self.light.outward(end)

    def locate(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Where points lie between lines.

        Args:
            points: within the frame `(pixel, 2)` x, y [pixels], float64.

        Returns:
            The line before each point, int64, the fraction of the way to the next line, and q, each `(pixel,)`.
        """
        light = self.light
        v = light.outward(points)
        size = torch.tensor([light.width, light.height], dtype=points.dtype, device=points.device)
        border = torch.where(v > 0.0, size, 0.0)
        # At the light itself v is zero; any line will do, for all of them pass through it.
        reach = torch.where(v == 0.0, torch.inf, (border - points) / v)
        tau, axis = reach.min(dim=1)
        inward = torch.where(torch.isinf(tau), torch.inf, tau / (1.0 + light.w * tau / light.scale))
        inward = inward.clamp(max=light.scale / light.w if light.w > 0.0 else torch.inf)
        end = points + torch.where(torch.isinf(tau), 0.0, tau)[:, None] * v
        line, fraction = torch.zeros_like(axis), torch.zeros_like(tau)
        first = 0
        for side, count in zip(light.exit_sides, self.sectors, strict=True):
            mine = (axis == side.axis) & ((v[:, side.axis] > 0.0) == (side.border > 0.0))
            place = (end[:, 1 - side.axis] * (count / side.extent)).clamp(0.0, float(count))
            number = place.floor().clamp(max=count - 1.0)
            line = torch.where(mine, first + number.long(), line)
            fraction = torch.where(mine, place - number, fraction)
            first += count + 1
        return line, fraction, inward


def arrange_lines(light: LightImage, gap: float) -> EpipolarLines:
    """Lines whose ends are at most `gap` apart along the border.

    Args:
        light: image of the light.
        gap: largest distance between the ends of neighbouring lines [pixels]; 1 or less resolves every pixel.

    Returns:
        The lines.

    Raises:
        ParameterError: for a gap that is not positive.
    """
    if not gap > 0.0:
        raise ParameterError(f"the gap between lines must be positive [pixels], not {gap}")
    return EpipolarLines(light, tuple(max(1, math.ceil(side.extent / gap)) for side in light.exit_sides))
