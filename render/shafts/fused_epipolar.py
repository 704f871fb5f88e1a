"""Fused twins of the loops over pixels and samples in `epipolar_sampling`; imported only where numba is installed."""

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from render.fused import announce_compilation, run_in_threads
from render.shafts.epipolar import EpipolarLines

ROWS = 16
"""Rows of the image of one call."""

LINES = 64
"""Lines of one call."""

PIXELS = 1 << 15
"""Pixels or samples of one call."""

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]
Integers = NDArray[np.int64]
Places = NDArray[np.int32]
Booleans = NDArray[np.bool_]


@njit(nogil=True, cache=True, error_model="numpy")
def _reach(point: float, v: float, size: float) -> float:
    """How far along v the border of the frame lies, along one axis."""
    if v == 0.0:
        return np.inf
    return ((size if v > 0.0 else 0.0) - point) / v


@njit(nogil=True, cache=True, error_model="numpy")
def _locate(
    light: Doubles, sides: Doubles, width: int, line: Integers, fraction: Doubles, inward: Doubles,
    nearest: Doubles, farthest: Doubles, first: int, last: int,
) -> None:  # fmt: skip
    """As `EpipolarLines.locate`, for the pixels of some rows.

    `light` is x, y, w, N, width and height of the frame; `sides` the gaps, the gaps per pixel and the first line of the left,
    right, upper and lower side, -1 for one through which no line leaves.
    """
    x, y, w, scale = light[0], light[1], light[2], light[3]
    for row in range(first, last):
        py = row + 0.5
        vy = (w * py - y) / scale
        for column in range(width):
            n, px = row * width + column, column + 0.5
            vx = (w * px - x) / scale
            across, down = _reach(px, vx, light[4]), _reach(py, vy, light[5])
            tau = min(across, down)
            axis = 0 if across <= down else 1
            q = tau / (1.0 + w * tau / scale) if tau < np.inf else np.inf
            inward[n] = min(q, scale / w) if w > 0.0 else q
            side = 2 * axis + (1 if (vx if axis == 0 else vy) > 0.0 else 0)
            line[n], fraction[n] = 0, 0.0
            if sides[side, 0] > 0.0:
                end = (py + tau * vy if axis == 0 else px + tau * vx) if tau < np.inf else (py if axis == 0 else px)
                place = min(max(end * sides[side, 1], 0.0), sides[side, 0])
                number = min(np.floor(place), sides[side, 0] - 1.0)
                line[n], fraction[n] = int(sides[side, 2]) + int(number), place - number
            for neighbour in (line[n], line[n] + 1):
                nearest[neighbour] = min(nearest[neighbour], inward[n])
                farthest[neighbour] = max(farthest[neighbour], inward[n])


def locate_pixels(lines: EpipolarLines) -> tuple[tuple[Tensor, Tensor, Tensor], Tensor, Tensor]:
    """As `epipolar_sampling._locate_pixels` and `_span_lines`.

    Args:
        lines: the lines.

    Returns:
        What `EpipolarLines.locate` says of all pixels, and the least and greatest q that each line is needed for `(line,)`.
    """
    announce_compilation("fused_epipolar", _locate.stats.cache_path)
    light, frame = lines.light, lines.light
    numbers = np.array([light.x, light.y, light.w, light.scale, frame.width, frame.height])
    sides, first = np.full((4, 3), -1.0), 0
    for side, gaps in zip(light.exit_sides, lines.sectors, strict=True):
        sides[2 * side.axis + (1 if side.border > 0.0 else 0)] = gaps, gaps / side.extent, first
        first += gaps + 1
    count = frame.width * frame.height
    line, fraction, inward = np.empty(count, np.int64), np.empty(count), np.empty(count)
    spans: dict[int, tuple[Doubles, Doubles]] = {}

    def work(begin: int, end: int) -> None:
        nearest, farthest = np.full(lines.lines, np.inf), np.full(lines.lines, -np.inf)
        _locate(numbers, sides, frame.width, line, fraction, inward, nearest, farthest, begin, end)
        spans[begin] = nearest, farthest

    run_in_threads(work, frame.height, ROWS)
    nearest = np.minimum.reduce([span[0] for span in spans.values()])
    farthest = np.maximum.reduce([span[1] for span in spans.values()])
    located = (torch.from_numpy(line), torch.from_numpy(fraction), torch.from_numpy(inward))
    return located, torch.from_numpy(nearest), torch.from_numpy(farthest)


@njit(nogil=True, cache=True, error_model="numpy")
def _lay(
    ends: Doubles, v: Doubles, start: Doubles, step: Doubles, count: Integers, offset: Integers, width: int, height: int,
    points: Floats, under: Integers, line: Integers, first: int, last: int,
) -> None:  # fmt: skip
    """Samples of the lines from `first` to `last`."""
    for j in range(first, last):
        for k in range(count[j]):
            n, q = offset[j] + k, start[j] + k * step[j]
            x, y = ends[j, 0] - q * v[j, 0], ends[j, 1] - q * v[j, 1]
            points[n, 0], points[n, 1], line[n] = x, y, j
            column, row = int(np.floor(x)), int(np.floor(y))
            under[n] = min(max(row, 0), height - 1) * width + min(max(column, 0), width - 1)


def lay_points(lines: EpipolarLines, start: Tensor, step: Tensor, count: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """As the end of `epipolar_sampling._lay_samples`.

    Args:
        lines: the lines.
        start, step: q of the first sample of each line, and between its samples `(line,)`.
        count: number of samples of each line `(line,)`.

    Returns:
        Points `(sample, 2)` [pixels], the pixel under each and the line of each `(sample,)`.
    """
    total = int(count.sum())
    points, under, line = np.empty((total, 2), np.float32), np.empty(total, np.int64), np.empty(total, np.int64)
    offset = (count.cumsum(0) - count).numpy()
    ends, v = lines.ends.numpy(), lines.light.outward(lines.ends).numpy()
    arrays = (start.numpy(), step.numpy(), count.numpy(), offset)
    width, height = lines.light.width, lines.light.height

    def work(first: int, last: int) -> None:
        _lay(ends, v, *arrays, width, height, points, under, line, first, last)

    run_in_threads(work, lines.lines, LINES)
    return torch.from_numpy(points), torch.from_numpy(under), torch.from_numpy(line)


@njit(nogil=True, cache=True, error_model="numpy")
def _pair(marked: Booleans, neighbours: Places, share: Floats) -> None:
    """Neighbours of each sample; the first and the last of each line are marked."""
    place, last = -1, 0
    for n in range(len(marked)):
        if marked[n]:
            place += 1
            neighbours[n, 0], neighbours[n, 1], share[n] = place, place, 0.0
            for between in range(last + 1, n):
                neighbours[between, 0], neighbours[between, 1] = place - 1, place
                share[between] = (between - last) / (n - last)
            last = n


def pair_samples(marked: Tensor) -> tuple[Tensor, Tensor]:
    """As `epipolar_sampling.pair_samples`.

    Args:
        marked: True for the samples to march `(sample,)`.

    Returns:
        Neighbours and shares, as in `EpipolarSampling`.
    """
    neighbours, share = np.empty((len(marked), 2), np.int32), np.empty(len(marked), np.float32)
    _pair(marked.numpy(), neighbours, share)
    return torch.from_numpy(neighbours), torch.from_numpy(share)


@njit(nogil=True, cache=True, error_model="numpy")
def _weigh(
    start: Doubles, step: Doubles, number: Integers, offset: Integers, dense_log: Floats, pixel_log: Floats,
    line: Integers, fraction: Doubles, inward: Doubles, gap: float, samples: Places, weights: Floats, first: int, last: int,
) -> None:  # fmt: skip
    """As `epipolar_sampling._weigh_pixels`, for the pixels from `first` to `last`."""
    kept = np.empty(4)
    for n in range(first, last):
        total, depth = 0.0, pixel_log[n]
        for side in range(2):
            near = line[n] + side
            across = fraction[n] if side == 1 else 1.0 - fraction[n]
            place = (inward[n] - start[near]) / step[near] if step[near] > 0.0 else 0.0
            final = number[near] - 1
            low = min(max(int(np.floor(place)), 0), max(final - 1, 0))
            along = min(max(place - low, 0.0), 1.0)
            samples[n, 2 * side] = offset[near] + low
            samples[n, 2 * side + 1] = offset[near] + min(low + 1, final)
            kept[2 * side], kept[2 * side + 1] = across * (1.0 - along), across * along
        for k in range(4):
            other = dense_log[samples[n, k]]
            if not (other == depth or abs(other - depth) <= gap):
                kept[k] = 0.0
            total += kept[k]
        for k in range(4):
            weights[n, k] = kept[k] / total if total > 0.0 else 0.0


def weigh_pixels(
    start: Tensor, step: Tensor, number: Tensor, offset: Tensor, dense_log: Tensor, pixel_log: Tensor,
    located: tuple[Tensor, Tensor, Tensor], gap: float,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """As `epipolar_sampling._weigh_pixels`.

    Args:
        start, step: q of the first sample of each line, and between its samples `(line,)`.
        number, offset: of the samples of each line, and that of its first `(line,)`.
        dense_log, pixel_log: logarithms of the depths of samples `(sample,)` and pixels `(pixel,)`.
        located: from `locate_pixels`.
        gap: largest difference of logarithms of one surface.

    Returns:
        Samples and weights `(pixel, 4)`.
    """
    count = len(pixel_log)
    samples, weights = np.empty((count, 4), np.int32), np.empty((count, 4), np.float32)
    arrays = [tensor.contiguous().numpy() for tensor in (start, step, number, offset)]
    logs = [tensor.float().contiguous().numpy() for tensor in (dense_log, pixel_log)]
    places = [tensor.numpy() for tensor in located]

    def work(first: int, last: int) -> None:
        _weigh(*arrays, *logs, *places, gap, samples, weights, first, last)

    run_in_threads(work, count, PIXELS)
    return torch.from_numpy(samples), torch.from_numpy(weights)


@njit(nogil=True, cache=True, error_model="numpy")
def _join(values: Floats, neighbours: Places, share: Floats, dense: Floats, first: int, last: int) -> None:
    for n in range(first, last):
        before, after = neighbours[n, 0], neighbours[n, 1]
        for c in range(values.shape[1]):
            dense[n, c] = values[before, c] + share[n] * (values[after, c] - values[before, c])


@njit(nogil=True, cache=True, error_model="numpy")
def _gather(dense: Floats, samples: Places, weights: Floats, image: Floats, first: int, last: int) -> None:
    for n in range(first, last):
        for c in range(dense.shape[1]):
            image[n, c] = 0.0
        for k in range(4):
            weight, sample = weights[n, k], samples[n, k]
            for c in range(dense.shape[1]):
                image[n, c] += weight * dense[sample, c]


def interpolate_pixels(values: Tensor, neighbours: Tensor, share: Tensor, samples: Tensor, weights: Tensor) -> Tensor:
    """Pixels from marched samples, as in `EpipolarSampling.interpolate`.

    Args:
        values: of the marched samples, float32 `(marched, channel)`.
        neighbours, share, samples, weights: `neighbours`, `share`, `pixel_samples` and `pixel_weights` of the sampling.

    Returns:
        Values `(pixel, channel)`, 0 for pixels without weights.
    """
    known, (pairs, shares) = values.contiguous().numpy(), (neighbours.numpy(), share.numpy())
    around, weighs = samples.numpy(), weights.numpy()
    dense, image = (
        np.empty((len(pairs), known.shape[1]), np.float32),
        np.empty((len(around), known.shape[1]), np.float32),
    )
    run_in_threads(lambda first, last: _join(known, pairs, shares, dense, first, last), len(pairs), PIXELS)
    run_in_threads(lambda first, last: _gather(dense, around, weighs, image, first, last), len(around), PIXELS)
    return torch.from_numpy(image)
