"""Samples along epipolar lines: which are marched, and how all pixels follow from them.

Dense samples lie evenly along each line. Of these every n-th is marched, and both samples on either side of any place where
the depth leaves its step of a logarithmic scale; the others are interpolated along the line, so never across an edge. A pixel
is interpolated from the four dense samples around it, those of another depth left out; where none is left the pixel is
marched by itself. Engelhardt & Dachsbacher 2010, sections 3 and 4; the lines are those of `render.shafts.epipolar`.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.errors import ParameterError
from render.fused import fused_loops_wanted
from render.shafts.depth_edges import compute_log_depth, depth_gap
from render.shafts.epipolar import EpipolarLines, LightImage, arrange_lines

PIXELS_IN_FLIGHT = 1 << 17
"""Pixels located or interpolated at once: their intermediate rows stay near the cache."""


@dataclass(frozen=True)
class EpipolarSettings:
    """How densely lines and samples lie.

    Args:
        line_gap: largest distance between the ends of neighbouring lines [pixels].
        sample_gap: largest distance between dense samples of a line [pixels].
        stride: every so many dense samples one is marched; 1 marches all.
        depth_tolerance: depths whose ratio is within 1 +- this belong to one surface.

    Raises:
        ParameterError: for a number that is not positive.
    """

    line_gap: float = 2.0
    sample_gap: float = 1.0
    stride: int = 16
    depth_tolerance: float = 0.1

    def __post_init__(self) -> None:
        if not (self.line_gap > 0.0 and self.sample_gap > 0.0 and self.stride >= 1 and self.depth_tolerance > 0.0):
            raise ParameterError(f"gaps, stride and depth tolerance must be positive: {self}")


@dataclass(frozen=True, eq=False)
class EpipolarSampling:
    """Where to march, and the weights by which the pixels follow.

    Args:
        lines: the lines.
        points: dense samples `(sample, 2)` x, y [pixels], line by line; some lie just outside of the frame.
        line: line of each dense sample `(sample,)`, int64.
        depth: depth of the pixel under each dense sample `(sample,)` [m].
        marched: numbers of the dense samples to march `(marched,)`, int64, rising.
        neighbours: the marched samples before and after each dense one, as places in `marched` `(sample, 2)`, int32.
        share: weight of the second of the two `(sample,)`.
        pixel_samples: the dense samples around each pixel `(pixel, 4)`, int32.
        pixel_weights: their weights `(pixel, 4)`, of sum 1, or all 0 for a pixel of its own.
        own_pixels: numbers of the pixels to march by themselves `(own,)`, int64, rising.
    """

    lines: EpipolarLines
    points: Tensor
    line: Tensor
    depth: Tensor
    marched: Tensor
    neighbours: Tensor
    share: Tensor
    pixel_samples: Tensor
    pixel_weights: Tensor
    own_pixels: Tensor

    @property
    def refined(self) -> Tensor:
        """True for the dense samples that are marched `(sample,)`."""
        mask = torch.zeros(len(self.points), dtype=torch.bool, device=self.points.device)
        mask[self.marched] = True
        return mask

    def interpolate(self, marched_values: Tensor, own_values: Tensor) -> Tensor:
        """Image from what has been marched.

        Args:
            marched_values: at `points[marched]` `(marched, channel)`.
            own_values: at the centres of `own_pixels` `(own, channel)`.

        Returns:
            Values of all pixels `(pixel, channel)`, row by row.

        Raises:
            ParameterError: for another number of values than of places.
        """
        if len(marched_values) != len(self.marched) or len(own_values) != len(self.own_pixels):
            raise ParameterError(
                f"{len(self.marched)} samples and {len(self.own_pixels)} pixels are to be marched, but values of "
                f"{len(marched_values)} and {len(own_values)} came"
            )
        image = self._interpolate(marched_values)
        image[self.own_pixels] = own_values
        return image

    def interpolate_lines(self, marched_values: Tensor) -> Tensor:
        """Values of all dense samples `(sample, channel)` from those of the marched ones `(marched, channel)`."""
        before, after = (marched_values.index_select(0, side) for side in self.neighbours.unbind(1))
        return torch.lerp(before, after, self.share.to(before.dtype)[:, None])

    def _interpolate(self, marched_values: Tensor) -> Tensor:
        if marched_values.dtype == torch.float32 and fused_loops_wanted(marched_values, self.share):
            from render.shafts.fused_epipolar import interpolate_pixels  # needs numba

            return interpolate_pixels(
                marched_values, self.neighbours, self.share, self.pixel_samples, self.pixel_weights
            )
        dense = self.interpolate_lines(marched_values)
        image = dense.new_empty(len(self.pixel_samples), dense.shape[1])
        for first in range(0, len(image), PIXELS_IN_FLIGHT):
            part = slice(first, first + PIXELS_IN_FLIGHT)
            weights = self.pixel_weights[part].to(dense.dtype)
            rows = dense.index_select(0, self.pixel_samples[part].reshape(-1)).reshape(-1, 4, dense.shape[1])
            image[part] = (weights[:, :, None] * rows).sum(1)
        return image


def build_epipolar_sampling(
    light: LightImage, depth: Tensor, settings: EpipolarSettings | None = None
) -> EpipolarSampling:
    """Lay lines and samples over a frame.

    Args:
        light: image of the light, for the same frame.
        depth: distance from the eye to the first surface seen by each pixel `(height, width)` [m], infinite for the sky.
        settings: density of lines and samples.

    Returns:
        The samples and the weights.

    Raises:
        ParameterError: for a depth of another shape than the frame, negative or NaN.
    """
    settings = settings or EpipolarSettings()
    if depth.shape != (light.height, light.width):
        raise ParameterError(
            f"the depth of a frame of {light.height} rows of {light.width} pixels has the shape {tuple(depth.shape)}"
        )
    lines = arrange_lines(light, settings.line_gap)
    log_depth = compute_log_depth(depth)
    located, nearest, farthest = _locate_pixels(lines, depth)
    dense = _lay_samples(lines, nearest, farthest, settings.sample_gap)
    dense_log = log_depth.reshape(-1)[dense.under]
    marked = _choose_marched(dense, dense_log, settings)
    neighbours, share = pair_samples(marked)
    samples, weights = _weigh_pixels(dense, dense_log, log_depth.reshape(-1), located, settings.depth_tolerance)
    own = torch.nonzero(weights.sum(1) == 0.0)[:, 0]
    return EpipolarSampling(
        lines=lines,
        points=dense.points,
        line=dense.line,
        depth=depth.reshape(-1)[dense.under],
        marched=torch.nonzero(marked)[:, 0],
        neighbours=neighbours,
        share=share,
        pixel_samples=samples,
        pixel_weights=weights,
        own_pixels=own,
    )


Located = tuple[Tensor, Tensor, Tensor]
"""What `EpipolarLines.locate` says of all pixels, row by row."""


def _locate_pixels(lines: EpipolarLines, depth: Tensor) -> tuple[Located, Tensor, Tensor]:
    """Where all pixels lie, and the least and greatest q that each line is needed for `(line,)`."""
    if fused_loops_wanted(depth):
        from render.shafts.fused_epipolar import locate_pixels  # needs numba

        return locate_pixels(lines)
    width, count = lines.light.width, lines.light.width * lines.light.height
    parts = []
    for first in range(0, count, PIXELS_IN_FLIGHT):
        number = torch.arange(first, min(first + PIXELS_IN_FLIGHT, count), device=depth.device)
        column, row = number % width, number // width
        parts.append(lines.locate(torch.stack([column, row], dim=1).double() + 0.5))
    line, fraction, inward = (torch.cat(part) for part in zip(*parts, strict=True))
    nearest = inward.new_full((lines.lines,), torch.inf)
    farthest = inward.new_full((lines.lines,), -torch.inf)
    for neighbour in (line, line + 1):
        nearest.scatter_reduce_(0, neighbour, inward, "amin")
        farthest.scatter_reduce_(0, neighbour, inward, "amax")
    return (line, fraction, inward), nearest, farthest


@dataclass(frozen=True, eq=False)
class _Dense:
    """Dense samples, line by line, and the pixels under them; q of the first of each line, their step in q, number, and first."""

    points: Tensor
    under: Tensor
    line: Tensor
    start: Tensor
    step: Tensor
    count: Tensor
    first: Tensor


def _lay_samples(lines: EpipolarLines, nearest: Tensor, farthest: Tensor, gap: float) -> _Dense:
    """Samples over the stretch of each line that the pixels on either side of it need, its ends included."""
    needed = farthest >= nearest
    nearest = torch.where(needed, nearest, 0.0)
    extent = torch.where(needed, farthest - nearest, 0.0)
    speed = torch.linalg.vector_norm(lines.light.outward(lines.ends.to(nearest.device)), dim=1)
    count = torch.where(needed, torch.ceil(extent * speed / gap).long() + 1, 0)
    step = extent / (count - 1).clamp(min=1)
    first = count.cumsum(0) - count
    if fused_loops_wanted(nearest):
        from render.shafts.fused_epipolar import lay_points  # needs numba

        return _Dense(*lay_points(lines, nearest, step, count), nearest, step, count, first)
    owner = torch.repeat_interleave(torch.arange(lines.lines, device=nearest.device), count)
    number = torch.arange(len(owner), device=nearest.device) - first[owner]
    points = lines.points_at(owner, nearest[owner] + number * step[owner])
    width, height = lines.light.width, lines.light.height
    column, row = points.floor().long().unbind(1)
    under = row.clamp(0, height - 1) * width + column.clamp(0, width - 1)
    return _Dense(points.to(torch.float32), under, owner, nearest, step, count, first)


def _choose_marched(dense: _Dense, log_depth: Tensor, settings: EpipolarSettings) -> Tensor:
    """True for the dense samples to march `(sample,)`."""
    # Within one step of the scale no two depths differ by more than the tolerance, however slowly they drift.
    level = torch.floor(log_depth / math.log1p(settings.depth_tolerance))
    number = torch.arange(len(dense.line), device=dense.line.device) - dense.first[dense.line]
    marked = number % settings.stride == 0
    ends = dense.first + dense.count - 1
    marked[ends[dense.count > 0]] = True
    broken = level[1:] != level[:-1]
    marked[1:] |= broken
    marked[:-1] |= broken
    return marked


def pair_samples(marked: Tensor) -> tuple[Tensor, Tensor]:
    """Between which marched samples each dense one lies.

    Args:
        marked: True for the dense samples to march, among them the first and the last of each line `(sample,)`.

    Returns:
        `neighbours` and `share` of an `EpipolarSampling`.
    """
    if fused_loops_wanted(marked):
        from render.shafts import fused_epipolar  # needs numba

        return fused_epipolar.pair_samples(marked)
    marched = torch.nonzero(marked)[:, 0]
    before = marked.long().cumsum(0) - 1  # place of the last marched sample up to here
    after = torch.where(marked, before, before + 1)
    low, high = marched[before], marched[after]
    share = (torch.arange(len(marked), device=marked.device) - low).double() / (high - low).clamp(min=1)
    return torch.stack([before, after], dim=1).int(), share.to(torch.float32)


def _weigh_pixels(
    dense: _Dense, dense_log: Tensor, pixel_log: Tensor, located: Located, tolerance: float
) -> tuple[Tensor, Tensor]:
    """The four dense samples around each pixel and their weights, those across an edge left out."""
    gap = math.log1p(tolerance)
    if fused_loops_wanted(dense_log, pixel_log):
        from render.shafts.fused_epipolar import weigh_pixels  # needs numba

        return weigh_pixels(dense.start, dense.step, dense.count, dense.first, dense_log, pixel_log, located, gap)
    samples, weights = [], []
    for line, fraction, inward, log_depth in zip(
        *(whole.split(PIXELS_IN_FLIGHT) for whole in (*located, pixel_log)), strict=True
    ):
        around, share = [], []
        for neighbour, across in ((line, 1.0 - fraction), (line + 1, fraction)):
            step = dense.step[neighbour]
            place = torch.where(step > 0.0, (inward - dense.start[neighbour]) / step, 0.0)
            last = dense.count[neighbour] - 1
            low = torch.minimum(place.floor().long().clamp(min=0), (last - 1).clamp(min=0))
            along = (place - low).clamp(0.0, 1.0)
            first = dense.first[neighbour]
            around += [first + low, first + torch.minimum(low + 1, last)]
            share += [across * (1.0 - along), across * along]
        number, weight = torch.stack(around, dim=1), torch.stack(share, dim=1)
        same = depth_gap(dense_log[number], log_depth[:, None]) <= gap
        weight = torch.where(same, weight, 0.0)
        total = weight.sum(1, keepdim=True)
        samples.append(number.int())
        weights.append(torch.where(total > 0.0, weight / total, 0.0).to(torch.float32))
    return torch.cat(samples), torch.cat(weights)
