"""Fused twins of the counting loops of `haze_histograms` and `soft_haze_histograms`; imported only where numba is installed."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from render.fused import run_in_threads

BLOCK = 2048
"""Pixels whose steps are computed before they are counted: the first loop is vectorised, the second cannot be."""

LANES = 4
"""Counters of each level that take turns: neighbouring pixels are often alike, and a counter must be written before it is read again."""

SERIAL_VALUES = 4_000_000
"""Pixels times amounts of air that one thread counts faster, in some milliseconds, than several are woken and wait for each other."""

Floats = NDArray[np.float32]


@njit(nogil=True, cache=True, error_model="numpy")
def _count_haze(
    cloud: Floats,
    sky: Floats,
    weight: float,
    levels: NDArray[np.uint8],
    rooted: bool,
    steps: float,
    counts: NDArray[np.int64],
) -> None:
    """Add the levels of one channel of one candidate behind one amount of air to the counts `(bin,)`."""
    zero, one = np.float32(0.0), np.float32(1.0)
    places = np.empty(BLOCK, np.uint16)
    lanes = np.zeros((LANES, len(counts)), np.int32)
    for first in range(0, len(sky), BLOCK):
        size = min(BLOCK, len(sky) - first)
        for n in range(size):
            value = weight * (cloud[first + n] - sky[first + n]) + sky[first + n]
            # The last bit of sky + (cloud - sky) is not the cloud's.
            value = cloud[first + n] if weight == one else value
            value = min(max(value, zero), one)
            places[n] = np.uint16((np.sqrt(value) if rooted else value) * steps)
        whole = size - size % LANES
        for n in range(0, whole, LANES):
            lanes[0, levels[places[n]]] += 1
            lanes[1, levels[places[n + 1]]] += 1
            lanes[2, levels[places[n + 2]]] += 1
            lanes[3, levels[places[n + 3]]] += 1
        for n in range(whole, size):
            lanes[0, levels[places[n]]] += 1
    for level in range(len(counts)):
        counts[level] += lanes[0, level] + lanes[1, level] + lanes[2, level] + lanes[3, level]


@njit(nogil=True, cache=True, error_model="numpy")
def _count_jobs(
    clouds: Floats,
    skies: Floats,
    haze: Floats,
    levels: NDArray[np.uint8],
    rooted: bool,
    steps: float,
    counts: NDArray[np.int64],
    first: int,
    last: int,
) -> None:
    channels = len(skies)
    for job in range(first, last):
        candidate, channel = job // channels, job % channels
        for kappa in range(haze.shape[1]):
            weight = haze[candidate, kappa, channel]
            row = counts[candidate, kappa, channel]
            _count_haze(clouds[candidate, channel], skies[channel], weight, levels, rooted, steps, row)


def count_hazes(
    clouds: Floats, skies: Floats, haze: Floats, levels: NDArray[np.uint8], rooted: bool, steps: int
) -> NDArray[np.int64]:
    """Number of pixels at each level, for every candidate, haze and channel.

    Args:
        clouds: (population, channel, pixel) finite linear light.
        skies: (channel, pixel) likewise.
        haze: (population, kappa, channel) shares of the cloud's own light.
        levels: (65536,) level of each step of the bent values.
        rooted: whether values are bent by the square root.
        steps: number of steps between 0 and 1.

    Returns:
        (population, kappa, channel, bin).
    """
    counts = np.zeros((*haze.shape, 256), np.int64)
    jobs = len(clouds) * len(skies)
    run_in_threads(
        lambda first, last: _count_jobs(clouds, skies, haze, levels, rooted, np.float32(steps), counts, first, last),
        jobs,
        _jobs_at_once(jobs, haze.shape[1] * skies.shape[1]),
    )
    return counts


def _jobs_at_once(jobs: int, looked_at: int) -> int:
    """One, or all where the whole is so little that waking threads would cost more than it saves.

    Args:
        jobs: number of them.
        looked_at: values that each looks at.
    """
    return jobs if jobs * looked_at <= SERIAL_VALUES else 1


@njit(nogil=True, cache=True, error_model="numpy")
def _share_jobs(
    clouds: Floats,
    skies: Floats,
    haze: Floats,
    positions: Floats,
    rooted: bool,
    steps: float,
    counts: NDArray[np.float64],
    first: int,
    last: int,
) -> None:
    """As `_count_jobs`, each pixel shared by the levels below and above its position."""
    zero, one = np.float32(0.0), np.float32(1.0)
    channels, pixels, hazes = len(skies), skies.shape[1], haze.shape[1]
    places = np.empty(BLOCK, np.uint16)
    for job in range(first * hazes, last * hazes):
        candidate, channel, kappa = job // hazes // channels, job // hazes % channels, job % hazes
        cloud, sky, weight = clouds[candidate, channel], skies[channel], haze[candidate, kappa, channel]
        below, above = np.zeros((LANES, 257)), np.zeros((LANES, 257))
        for start in range(0, pixels, BLOCK):
            size = min(BLOCK, pixels - start)
            for n in range(size):
                value = min(max(weight * (cloud[start + n] - sky[start + n]) + sky[start + n], zero), one)
                places[n] = np.uint16((np.sqrt(value) if rooted else value) * steps)
            for n in range(size):
                position = positions[places[n]]
                level = int(position)
                share = position - np.float32(level)
                below[n % LANES, level] += one - share
                above[n % LANES, level + 1] += share
        for level in range(256):
            for lane in range(LANES):
                counts[candidate, kappa, channel, level] += below[lane, level] + above[lane, level]


def share_hazes(
    clouds: Floats, skies: Floats, haze: Floats, positions: Floats, rooted: bool, steps: int
) -> NDArray[np.float64]:
    """Number of pixels at each level, each shared by the two next to it.

    Args:
        clouds, skies, haze, rooted, steps: as of `count_hazes`.
        positions: (65536,) place 0..255 between the levels of each step of the bent values.

    Returns:
        (population, kappa, channel, bin).
    """
    counts = np.zeros((*haze.shape, 256))
    run_in_threads(
        lambda first, last: _share_jobs(clouds, skies, haze, positions, rooted, np.float32(steps), counts, first, last),
        len(clouds) * len(skies),
        _jobs_at_once(len(clouds) * len(skies), haze.shape[1] * skies.shape[1]),
    )
    return counts
