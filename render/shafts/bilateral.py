"""March few pixels, then fill up the image by two one-dimensional passes that respect the edges of depth.

Ali, Sunar & Kolivand 2017, "Soft bilateral filtering volumetric shadows using cube shadow maps": rays are marched at a
reduced resolution, and the image is interpolated along rows and then along columns. A value weighs

    w = exp(-x^2 / (2 s^2)) exp(-(log(d / d'))^2 / (2 t^2))

where x is the distance in marched pixels, s a quarter of the taps, d the depth of the pixel that is filled, d' that of the
marched one, and t the tolerance of depth. Linear interpolation takes two taps, with the hat 1 - |x| in the place of the first
factor. A pixel none of whose taps are of like depth is guessed from the nearest depth and reported, so that it can be marched.

The reduced image is a subset of the pixels, not a mean over blocks: each marched value belongs to one depth.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from render.errors import ParameterError
from render.fused import fused_loops_wanted
from render.shafts.depth_edges import compute_log_depth, depth_gap

TAP_COUNTS = (1, 2, 4, 8, 16, 32)
"""Marched pixels that enter each filled one, in each pass; 1 and 2 are the nearest one and linear interpolation."""


@dataclass(frozen=True)
class ReducedFrame:
    """Which pixels of a frame are marched: the middle ones of blocks of `factor` by `factor` pixels.

    Args:
        width, height: pixel counts of the whole frame.
        factor: edge of a block [pixels]; 1 marches every pixel.

    Raises:
        ParameterError: for an empty frame or block.
    """

    width: int
    height: int
    factor: int

    def __post_init__(self) -> None:
        if min(self.width, self.height, self.factor) < 1:
            raise ParameterError(f"a frame and its blocks need at least one pixel: {self}")

    @property
    def columns(self) -> Tensor:
        """Columns of the marched pixels `(reduced width,)`, int64."""
        return _marched_along(self.width, self.factor)

    @property
    def rows(self) -> Tensor:
        """Rows of the marched pixels `(reduced height,)`, int64."""
        return _marched_along(self.height, self.factor)

    def pixels(self) -> Tensor:
        """Numbers of the marched pixels, row by row `(reduced height * reduced width,)`, int64."""
        return (self.rows[:, None] * self.width + self.columns).reshape(-1)


def _marched_along(size: int, factor: int) -> Tensor:
    # A cut block at the end is marched within the frame.
    blocks = -(-size // factor)
    return (torch.arange(blocks) * factor + factor // 2).clamp(max=size - 1)


@dataclass(frozen=True, eq=False)
class FilledFrame:
    """A whole image, and where it is a guess.

    Args:
        image: `(height, width, channel)`.
        unmatched: True for pixels that no marched one of like depth has reached `(height, width)`.
    """

    image: Tensor
    unmatched: Tensor


def fill_frame(
    frame: ReducedFrame, marched: Tensor, depth: Tensor, taps: int, depth_tolerance: float = 0.1
) -> FilledFrame:
    """Whole image from its marched pixels.

    Args:
        frame: which pixels were marched.
        marched: their values, linear `(reduced height, reduced width, channel)`.
        depth: distance from the eye to the first surface of all pixels `(height, width)` [m], infinite for the sky.
        taps: marched pixels in each pass, one of `TAP_COUNTS`.
        depth_tolerance: a ratio of depths minus 1: t is the logarithm of the ratio, and depths within it are alike.

    Returns:
        The image; with a factor of 1 and one tap it is `marched`.

    Raises:
        ParameterError: for shapes that do not fit the frame, another number of taps, or a tolerance that is not positive.
    """
    if taps not in TAP_COUNTS:
        raise ParameterError(f"the filter takes one of {TAP_COUNTS} taps, not {taps}")
    if not depth_tolerance > 0.0:
        raise ParameterError(f"the tolerance of depth must be positive, not {depth_tolerance}")
    rows, columns = frame.rows.to(depth.device), frame.columns.to(depth.device)
    if depth.shape != (frame.height, frame.width) or marched.shape[:-1] != (len(rows), len(columns)):
        raise ParameterError(
            f"{frame} needs a depth ({frame.height}, {frame.width}) and marched pixels ({len(rows)}, {len(columns)}, "
            f"channel), not {tuple(depth.shape)} and {tuple(marched.shape)}"
        )
    log_depth = compute_log_depth(depth)
    step = math.log1p(depth_tolerance)
    in_rows = log_depth[rows]
    across, down = _choose_taps(columns, frame.width, taps), _choose_taps(rows, frame.height, taps)
    known = torch.ones(marched.shape[:-1], dtype=torch.bool, device=depth.device)
    wide, matched = _fill_along(1, marched, known, in_rows[:, columns], in_rows, across, step)
    image, matched = _fill_along(0, wide, matched, in_rows, log_depth, down, step)
    return FilledFrame(image, ~matched)


def filter_image(image: Tensor, depth: Tensor, taps: int, depth_tolerance: float = 0.1) -> Tensor:
    """Smooth a whole image along rows and then columns without crossing edges of depth, against the banding of few steps.

    Args:
        image: linear values `(height, width, channel)`.
        depth, taps, depth_tolerance: as for `fill_frame`.

    Returns:
        The image, of the same shape. One or two taps leave it as it is.
    """
    height, width = depth.shape
    return fill_frame(ReducedFrame(width, height, 1), image, depth, taps, depth_tolerance).image


def _nearest(offset: Tensor, taps: int) -> Tensor:
    return torch.ones_like(offset)


def _hat(offset: Tensor, taps: int) -> Tensor:
    return (1.0 - offset.abs()).clamp(min=0.0)


def _gaussian(offset: Tensor, taps: int) -> Tensor:
    return torch.exp(-0.5 * (offset * (4.0 / taps)).square())


_KERNELS: dict[int, Callable[[Tensor, int], Tensor]] = {1: _nearest, 2: _hat}


@dataclass(frozen=True, eq=False)
class Taps:
    """Which marched places enter each place along an axis.

    Args:
        number: numbers of the marched places `(place, tap)`, int64.
        near: the first factor of their weights, 0 for those beyond the ends `(place, tap)`.
        nearest: number of the marched place nearest to each place `(place,)`, int64.
    """

    number: Tensor
    near: Tensor
    nearest: Tensor


def _choose_taps(marched: Tensor, size: int, taps: int) -> Taps:
    known = marched.to(torch.float32)
    place = torch.arange(size, device=marched.device, dtype=known.dtype)
    nearest = torch.searchsorted(0.5 * (known[1:] + known[:-1]), place)
    below = torch.searchsorted(known, place, right=True) - 1
    first = nearest if taps == 1 else below - (taps // 2 - 1)
    unit = known.diff()[below.clamp(0, len(known) - 2)] if len(known) > 1 else torch.ones_like(place)
    number = first[:, None] + torch.arange(taps, device=marched.device)
    inside = (number >= 0) & (number < len(known))
    number = number.clamp(0, len(known) - 1)
    offset = (place[:, None] - known[number]) / unit[:, None]
    return Taps(number, torch.where(inside, _KERNELS.get(taps, _gaussian)(offset, taps), 0.0), nearest)


def _fill_along(
    axis: int, values: Tensor, valid: Tensor, known_depth: Tensor, wanted_depth: Tensor, taps: Taps, step: float
) -> tuple[Tensor, Tensor]:
    """One pass along an axis: marched values become values at all places, some of them matched by depth."""
    if values.dtype == wanted_depth.dtype == torch.float32 and fused_loops_wanted(values, wanted_depth):
        from render.shafts.fused_bilateral import fill_along  # needs numba

        return fill_along(axis, values, valid, known_depth, wanted_depth, taps, step)
    along = [1, 1]
    along[axis] = wanted_depth.shape[axis]
    total = torch.zeros_like(wanted_depth)
    result = values.new_zeros(*wanted_depth.shape, values.shape[-1])
    best = taps.nearest.reshape(along).expand(wanted_depth.shape)
    best_gap = torch.full_like(wanted_depth, torch.inf)
    for number, near in zip(taps.number.unbind(1), taps.near.unbind(1), strict=True):
        weight = near.reshape(along) * valid.index_select(axis, number)
        gap = depth_gap(known_depth.index_select(axis, number), wanted_depth)
        gap = torch.where(weight > 0.0, gap, torch.inf)
        weight = weight * torch.exp(-0.5 * (gap / step).square())
        total += weight
        result.addcmul_(weight[..., None].to(result.dtype), values.index_select(axis, number))
        best = torch.where(gap < best_gap, number.reshape(along), best)
        best_gap = torch.minimum(gap, best_gap)
    # Quotients of numbers below the smallest normal one have no digits left.
    found = total >= torch.finfo(total.dtype).tiny
    result /= torch.where(found, total, 1.0)[..., None]
    lost = list(torch.nonzero(~found, as_tuple=True))
    target = tuple(lost)
    lost[axis] = best[target]
    result[target] = values[tuple(lost)]
    return result, best_gap <= step
