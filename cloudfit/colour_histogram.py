"""Histograms of the 256 display levels: of a photograph's pixels, and of a whole population of rendered clouds in haze.

A pixel's level is that of an 8-bit image: round(255 curve(x)) of the linear value x clamped to 0..1. No power is
computed per pixel: x is bent by a cheap function (the square root, close to the sRGB curve), cut into
256 steps per level, and the step looked up in a table. So the border between two levels lies within half a step of its
place: at most 1/250 of a level off, and 1 pixel in about 1000 takes the neighbouring level. Photograph and rendering
pass through the same table, so equal pixels have equal levels. Without a curve the borders are exact
to float32 rounding.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from threading import Lock

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from render.colour import DISPLAY_CURVES
from render.errors import ParameterError
from render.fused import fused_loops_wanted

LEVELS = 256
STEPS_PER_LEVEL = 256
STEPS = (LEVELS - 1) * STEPS_PER_LEVEL
CHANNELS = 3

# The haze is counted as an 8-bit channel beside the level.
MOST_HAZES = 256

# A block of pixels in all its hazes is one array operation: long enough that threads rarely meet at the interpreter's
# lock, short enough that the buffers of eleven hazes (2 MB) stay in the cache of a core.
PIXELS_PER_BLOCK = 16_384

FloatArray = NDArray[np.float32]
LevelArray = NDArray[np.uint8]


@dataclass(frozen=True)
class Bend:
    """A cheap increasing function on 0..1 that a display curve is close to, applied in place, and its inverse."""

    apply: Callable[[FloatArray], object]
    invert: Callable[[Tensor], Tensor]


def _take_root(values: FloatArray) -> None:
    np.sqrt(values, out=values)


def _keep(values: FloatArray) -> None:
    """Without a display curve levels are equal steps of linear light already."""


SQUARE_ROOT = Bend(_take_root, torch.square)
IDENTITY = Bend(_keep, torch.clone)
BENDS: dict[str, Bend] = {"none": IDENTITY}


@dataclass(frozen=True)
class LevelTable:
    """Level of every step of the bent values, as both are used by the counting loop.

    Args:
        bend: function applied to the clamped linear values.
        levels: (65536,) uint8, level of step floor(STEPS bend(x)).
        positions: (65536,) float32, the same before rounding, 0..255.
    """

    bend: Bend
    levels: LevelArray
    positions: FloatArray


@lru_cache
def build_level_table(display_curve: str) -> LevelTable:
    """Table of display levels for one of the `DISPLAY_CURVES`.

    Args:
        display_curve: name of the curve; it must treat each channel alone, and alike.

    Returns:
        the table.

    Raises:
        ParameterError: when there is no such curve.
    """
    if display_curve not in DISPLAY_CURVES:
        raise ParameterError(f"expected a display curve out of {', '.join(DISPLAY_CURVES)}, got {display_curve!r}")
    bend = BENDS.get(display_curve, SQUARE_ROOT)
    middle = ((torch.arange(1 << 16, dtype=torch.float64) + 0.5) / STEPS).clamp(max=1.0)
    linear = bend.invert(middle)[:, None].expand(-1, CHANNELS)
    positions = (DISPLAY_CURVES[display_curve](linear)[:, 0] * (LEVELS - 1)).clamp(0, LEVELS - 1)
    return LevelTable(bend, positions.round().to(torch.uint8).numpy(), positions.float().numpy())


def colour_histogram(pixels: Tensor, display_curve: str = "srgb") -> Tensor:
    """Histogram of the display levels of an image, channel by channel.

    Args:
        pixels: (pixel, channel) linear light, display white at 1.
        display_curve: name of one of the `DISPLAY_CURVES`.

    Returns:
        (channel, bin) float64, each channel sums to 1; NaN in a channel with a value that is not finite.

    Raises:
        ParameterError: when there is no pixel, the shape is another or there is no such curve.
    """
    if pixels.ndim != 2 or pixels.shape[1] != CHANNELS or pixels.shape[0] == 0:
        raise ParameterError(f"pixels: expected (pixel, channel) = (1 or more, 3), got {tuple(pixels.shape)}")
    image = pixels.T
    return haze_histograms(image[None], torch.zeros_like(image), (1.0,), display_curve)[0, 0]


def haze_histograms(
    cloud: Tensor, sky: Tensor, haze_weights: Tensor | Sequence[float], display_curve: str = "srgb"
) -> Tensor:
    """Histograms of every rendered cloud behind several amounts of air (Dobashi et al. 2012, eq. 3).

    image = a cloud + (1 - a) sky for each weight a = exp(-kappa_a t_c), cloud and sky exactly at its ends. Blocks of pixels are counted on
    `torch.get_num_threads()` threads, and no hazy image is ever held whole, so that the memory used beside the
    arguments and the result does not grow with the number of pixels.

    Args:
        cloud: (population, channel, pixel) linear light of the cloud pixels, with the sky that shines through it.
        sky: (channel, pixel) linear light of the sky behind the same pixels.
        haze_weights: shares a of the cloud's own light, in 0..1: (kappa,) the same for all, or (population, kappa,
            channel) each its own.
        display_curve: name of one of the `DISPLAY_CURVES`.

    Returns:
        (population, kappa, channel, bin) float64 on the CPU; each histogram sums to 1. A channel with a value of cloud
        or sky that is not finite is NaN in all its bins, so that the loss cannot miss it.

    Raises:
        ParameterError: when shapes do not fit, there is no pixel, a weight is outside 0..1 or there is no such curve.
    """
    weights = torch.as_tensor(haze_weights, dtype=torch.float64)
    _require_haze_arguments(cloud, sky, weights)
    table = build_level_table(display_curve)
    if weights.ndim == 1:
        weights = weights[:, None].expand(len(cloud), -1, CHANNELS)
    clouds, skies, haze = _as_array(cloud), _as_array(sky), _as_array(weights)
    # A float64 sum of float32 values is finite exactly when they all are.
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(clouds.sum(axis=-1, dtype=np.float64) + skies.sum(axis=-1, dtype=np.float64))
    if fused_loops_wanted():
        from cloudfit.fused_histogram import count_hazes  # needs numba

        counts = count_hazes(clouds, skies, haze, table.levels, table.bend is SQUARE_ROOT, STEPS).astype(np.float64)
        counts[np.broadcast_to(~finite[:, None], haze.shape)] = np.nan
    else:
        counts = _count_blocks(clouds, skies, haze, finite, table)
    return torch.from_numpy(counts / clouds.shape[-1])


def _count_blocks(
    clouds: FloatArray, skies: FloatArray, haze: FloatArray, finite: NDArray[np.bool_], table: LevelTable
) -> NDArray[np.float64]:
    """Number of pixels at each level (population, kappa, channel, bin); NaN where `finite` (population, channel) is false."""
    counts = np.zeros((*haze.shape, LEVELS))
    lock = Lock()

    def count(job: tuple[int, int]) -> None:
        channel, start = job
        block = slice(start, start + PIXELS_PER_BLOCK)
        part = _count_block(
            clouds[:, channel, block], skies[channel, block], haze[:, :, channel, None], finite[:, channel], table
        )
        with lock:
            counts[:, :, channel] += part

    jobs = [(channel, start) for channel in range(CHANNELS) for start in range(0, clouds.shape[-1], PIXELS_PER_BLOCK)]
    with ThreadPoolExecutor(min(torch.get_num_threads(), len(jobs))) as pool:
        list(pool.map(count, jobs))
    return counts


def _count_block(
    clouds: FloatArray, sky: FloatArray, haze: FloatArray, finite: NDArray[np.bool_], table: LevelTable
) -> NDArray[np.float64]:
    """Number of pixels at each level in one block of one channel, for every candidate and haze.

    Args:
        clouds: (population, pixel).
        sky: (pixel,).
        haze: (population, kappa, 1).
        finite: (population,) whether to count a candidate.
        table: levels of the bent values.

    Returns:
        (population, kappa, bin); NaN for a candidate that is not counted.
    """
    hazes = haze.shape[1]
    shape = (hazes, len(sky))
    hazy, steps, levels = np.empty(shape, np.float32), np.empty(shape, np.uint16), np.empty(shape, np.uint8)
    rows = np.repeat(np.arange(hazes, dtype=np.uint8)[:, None], len(sky), axis=1)
    counts = np.full((len(clouds), hazes, LEVELS), np.nan)
    for candidate in np.flatnonzero(finite):
        np.multiply(haze[candidate], clouds[candidate] - sky, out=hazy)
        np.add(hazy, sky, out=hazy)
        # The last bit of sky + (cloud - sky) is not the cloud's.
        hazy[haze[candidate, :, 0] == 1] = clouds[candidate]
        np.clip(hazy, np.float32(0), np.float32(1), out=hazy)
        table.bend.apply(hazy)
        np.multiply(hazy, np.float32(STEPS), out=steps, casting="unsafe")
        _look_up_levels(steps, table.levels, levels)
        joint = cv2.calcHist([levels, rows], [0, 1], None, [LEVELS, hazes], [0, LEVELS, 0, hazes])
        counts[candidate] = joint.T
    return counts


def _look_up_by_opencv(steps: NDArray[np.uint16], table: LevelArray, levels: LevelArray) -> None:
    cv2.LUT(steps, table[None], dst=levels)


def _look_up_by_numpy(steps: NDArray[np.uint16], table: LevelArray, levels: LevelArray) -> None:
    np.take(table, steps, out=levels, mode="clip")


def _choose_look_up() -> Callable[[NDArray[np.uint16], LevelArray, LevelArray], None]:
    """OpenCV's look-up, a third of the time of numpy's, from the version on (4.13) that takes 16-bit steps."""
    steps, levels = np.zeros((1, 1), np.uint16), np.zeros((1, 1), np.uint8)
    try:
        _look_up_by_opencv(steps, np.zeros(1 << 16, np.uint8), levels)
    except cv2.error:
        return _look_up_by_numpy
    return _look_up_by_opencv


_look_up_levels = _choose_look_up()


def _as_array(image: Tensor) -> FloatArray:
    return image.detach().to(device="cpu", dtype=torch.float32).contiguous().numpy()


def _require_haze_arguments(cloud: Tensor, sky: Tensor, weights: Tensor) -> None:
    fits = cloud.ndim == 3 and sky.ndim == 2 and cloud.shape[1:] == sky.shape and sky.shape[0] == CHANNELS
    if not fits or sky.shape[1] == 0:
        raise ParameterError(
            "expected cloud (population, channel, pixel) and sky (channel, pixel) with three channels and the same "
            f"one or more pixels, got {tuple(cloud.shape)} and {tuple(sky.shape)}"
        )
    shared = weights.ndim == 1
    hazes = weights.shape[0] if shared else weights.shape[1] if weights.ndim == 3 else 0
    fits = shared or weights.shape == (len(cloud), hazes, CHANNELS)
    if not fits or not 1 <= hazes <= MOST_HAZES or not bool(((weights >= 0) & (weights <= 1)).all()):
        raise ParameterError(
            f"haze_weights: expected (kappa,) or (population, kappa, channel) = ({len(cloud)}, kappa, {CHANNELS}), kappa 1 to "
            f"{MOST_HAZES}, shares in 0..1; got {tuple(weights.shape)}: {weights}"
        )
