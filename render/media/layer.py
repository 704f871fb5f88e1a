"""What every layered medium offers, and the part of a straight ray that lies within a layer.

A medium is a horizontal layer whose extinction depends on the height alone. A ray is told by the height at which it
begins, its slope (the vertical component of its unit direction) and its length, so one function serves the camera's
ray and that towards the sun.

Inside the package heights become levels: heights above the medium's datum, where its extinction is known exactly (a
linear profile has it at the top, where there is none). A short ray from there keeps all its digits.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from render.errors import ParameterError

Number = Tensor | float

STEEPEST = 1.0 + 1e-6
"""Unit vectors of float32 may come out longer than 1 by their rounding."""


class LayeredMedium(Protocol):
    """A horizontal layer. Every argument and field broadcasts against every other."""

    @property
    def base(self) -> Number:
        """Lower border of the layer [m], below which there is nothing; may be minus infinity."""

    @property
    def top(self) -> Number:
        """Upper border of the layer [m], above which there is nothing; may be infinity."""

    @property
    def datum(self) -> Number:
        """Height from which levels are counted [m], finite."""

    def extinction_at(self, level: Tensor) -> Tensor:
        """Extinction [1/m] at a level [m] within the layer."""

    def mean_extinction(self, first: Tensor, last: Tensor) -> Tensor:
        """Mean extinction [1/m] between two finite levels [m] within the layer, in either order."""

    def unbounded_depth(self, level: Tensor, slope: Tensor) -> Tensor:
        """Optical depth [1] of a ray that begins at a level [m] within the layer and never leaves it."""

    def invert_depth(self, level: Tensor, slope: Tensor, depth: Tensor) -> Tensor:
        """Distance [m] to an optical depth [1] that a ray from a level [m] within the layer does reach in it."""

    def curved_depth(self, level: Tensor, slope: Tensor, radius: float) -> Tensor:
        """Optical depth [1] from a level [m] within the layer to the sun, over ground of a radius [m]."""


@dataclass(frozen=True, eq=False)
class Section:
    """The part of a ray within a layer; what it names broadcasts to one shape.

    Args:
        start: distance from the beginning of the ray to the layer [m]; 0 where the ray misses it.
        length: [m], 0 where the ray misses the layer; may be infinite.
        first: level at which the part begins [m].
        last: level at which it ends [m]; where `unbounded`, that at which it begins.
        unbounded: whether the part has no end.
    """

    start: Tensor
    length: Tensor
    first: Tensor
    last: Tensor
    unbounded: Tensor


def cut_ray(medium: LayeredMedium, level: Tensor, slope: Tensor, distance: Number = math.inf) -> Section:
    """Cut a ray down to the part within the layer.

    Lengths come from heights where the ray crosses a border and from the distance where it does not, so neither a
    level ray nor a far camera costs accuracy.

    Args:
        medium: the layer.
        level: of the beginning of the ray, its height above the datum [m].
        slope: vertical component of the unit direction [1].
        distance: length of the ray [m], not negative; may be infinite.

    Returns:
        The part within the layer.
    """
    level, slope, distance, base, top, datum = match(level, slope, distance, medium.base, medium.top, medium.datum)
    base, top = base - datum, top - datum
    endless = torch.isinf(distance)
    reached = level + slope * torch.where(endless, 0.0, distance)
    reached = torch.where(endless & (slope != 0.0), torch.copysign(distance, slope), reached)
    first, last = _clamp(level, base, top), _clamp(reached, base, top)
    unbounded = endless & (last == reached)
    # A ray that begins on a border and leaves is outside, even if it is too short for its height to change.
    leaves = torch.where(slope < 0.0, level == base, level == top) & (slope != 0.0)
    cut = (first != level) | (last != reached) | leaves
    last = torch.where(unbounded | leaves, first, last)
    rise = torch.where(slope == 0.0, 1.0, slope)
    length = torch.where(cut, (last - first) / rise, distance)
    length = torch.where(unbounded, math.inf, length)
    start = torch.where(length > 0.0, (first - level) / rise, 0.0)
    return Section(start, length, first, last, unbounded)


def section_depth(medium: LayeredMedium, section: Section, slope: Tensor) -> Tensor:
    """Optical depth [1] of the part of a ray within the layer: its length times the mean extinction between its ends."""
    length = torch.where(section.unbounded, 0.0, section.length)
    bounded = length * medium.mean_extinction(section.first, section.last)
    # An extinction that overflows deep below an exponential layer must not turn a length of 0 into NaN.
    bounded = torch.where(length == 0.0, torch.zeros_like(bounded), bounded)
    return torch.where(section.unbounded, medium.unbounded_depth(section.first, slope), bounded)


def light_depth(medium: LayeredMedium, level: Tensor, sun_slope: Tensor) -> Tensor:
    """Optical depth [1] from a level [m] to the sun over flat ground; infinite where its light never enters the layer."""
    return section_depth(medium, cut_ray(medium, level, sun_slope), sun_slope)


def invert_section(medium: LayeredMedium, level: Tensor, slope: Tensor, depth: Tensor) -> Tensor:
    """Distance [m] at which a ray from a level [m] has passed an optical depth [1]; see `find_distance`."""
    section = cut_ray(medium, level, slope)
    depth, total = torch.broadcast_tensors(depth, section_depth(medium, section, slope))
    passed = (depth > 0.0) & (depth <= total) & torch.isfinite(depth)
    any_passed = 0.5 * torch.where(torch.isfinite(total), total, 1.0)
    within = medium.invert_depth(section.first, slope, torch.where(passed, depth, any_passed))
    distance = section.start + torch.where(passed, torch.minimum(within, section.length), 0.0)
    return torch.where(passed | ((depth == 0.0) & (total > 0.0)), distance, math.inf)


def compute_optical_depth(medium: LayeredMedium, height: Number, slope: Number, distance: Number = math.inf) -> Tensor:
    """Optical depth of a ray.

    Args:
        medium: the layer.
        height: of the beginning of the ray [m].
        slope: vertical component of the unit direction [1].
        distance: length of the ray [m]; may be infinite.

    Returns:
        Optical depth [1], broadcast shape; infinite where the ray never leaves fog that does not thin out.

    Raises:
        ParameterError: for a height that is not finite, a slope beyond -1..1, or a distance that is negative or NaN.
    """
    height, slope, distance = match_rays(height, slope, distance)
    return section_depth(medium, cut_ray(medium, height - medium.datum, slope, distance), slope)


def find_distance(medium: LayeredMedium, height: Number, slope: Number, depth: Number) -> Tensor:
    """Distance at which a ray has passed an optical depth.

    Args:
        medium: the layer.
        height: of the beginning of the ray [m].
        slope: vertical component of the unit direction [1].
        depth: optical depth [1], not negative.

    Returns:
        Distance [m]; where the depth is 0 that of the border of the layer, infinite where the whole ray has less.

    Raises:
        ParameterError: see `compute_optical_depth`; also for a depth that is negative or NaN.
    """
    height, slope, depth = match_rays(height, slope, depth)
    return invert_section(medium, height - medium.datum, slope, depth)


def check_layer(name: str, extinction: Number, base: Number, top: Number, finite: bool = False) -> None:
    """Raise ParameterError for an extinction that is no finite number of at least 0, or borders that are not in order."""
    values = torch.as_tensor(extinction)
    if not bool((torch.isfinite(values) & (values >= 0.0)).all()):
        raise ParameterError(f"{name}: expected a finite extinction of at least 0 per metre, got {extinction}")
    if not bool((torch.as_tensor(base) < torch.as_tensor(top)).all()):
        raise ParameterError(f"{name}: expected a base below the top, got {base} m and {top} m")
    if finite and not bool(torch.isfinite(torch.as_tensor(top) - torch.as_tensor(base)).all()):
        raise ParameterError(f"{name}: expected finite borders, got {base} m and {top} m")


def match(*values: Number) -> tuple[Tensor, ...]:
    """Tensors of one shape, floating-point type and device; plain numbers follow the tensors, float32 follows float64."""
    tensors = [value for value in values if isinstance(value, Tensor) and value.is_floating_point()]
    dtype = torch.get_default_dtype()
    if tensors:
        dtype = torch.float64 if any(t.dtype == torch.float64 for t in tensors) else tensors[0].dtype
    device = tensors[0].device if tensors else None
    return torch.broadcast_tensors(*(torch.as_tensor(value, dtype=dtype, device=device) for value in values))


def match_rays(height: Number, slope: Number, extent: Number, *sun: Number) -> tuple[Tensor, ...]:
    """`match` for heights [m], slopes [1], distances or depths, and slopes towards the sun [1].

    Raises:
        ParameterError: for a height that is not finite, a slope beyond -1..1, or an extent that is negative or NaN.
    """
    height, slope, extent, *sun_slope = match(height, slope, extent, *sun)
    if not bool(torch.isfinite(height).all()):
        raise ParameterError("expected finite heights of the beginnings of the rays [m]")
    for slopes in (slope, *sun_slope):
        if not bool((slopes.abs() <= STEEPEST).all()):
            raise ParameterError("expected slopes in -1..1: the vertical component of a unit direction")
    if not bool((extent >= 0.0).all()):
        raise ParameterError("expected distances and optical depths of at least 0; they may be infinite")
    return height, slope, extent, *sun_slope


def finite_or(value: Number, other: Number) -> Number:
    """The first number where it is finite, else the other."""
    if isinstance(value, Tensor) or isinstance(other, Tensor):
        value, other = match(value, other)
        return torch.where(torch.isfinite(value), value, other)
    return value if math.isfinite(value) else other


def _clamp(level: Tensor, base: Tensor, top: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(level, base), top)
