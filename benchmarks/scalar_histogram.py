"""The plain scalar loop that the counting of hazes is measured against: what one writes first, compiled by numba."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from render.fused import run_in_threads


@njit(nogil=True, cache=True, error_model="numpy")
def _count(
    clouds: NDArray[np.float32],
    skies: NDArray[np.float32],
    weights: NDArray[np.float32],
    levels: NDArray[np.uint8],
    steps: float,
    counts: NDArray[np.int64],
    first: int,
    last: int,
) -> None:
    """Candidates and channels number `first` to `last`: one pixel after the other, each counted as soon as its level is known."""
    channels = len(skies)
    zero, one = np.float32(0.0), np.float32(1.0)
    for job in range(first, last):
        candidate, channel = job // channels, job % channels
        for kappa in range(len(weights)):
            weight = weights[kappa]
            for pixel in range(skies.shape[1]):
                sky = skies[channel, pixel]
                value = min(max(weight * (clouds[candidate, channel, pixel] - sky) + sky, zero), one)
                counts[candidate, kappa, channel, levels[int(np.sqrt(value) * steps)]] += 1


def count_by_scalar_loop(
    clouds: NDArray[np.float32],
    skies: NDArray[np.float32],
    weights: NDArray[np.float32],
    levels: NDArray[np.uint8],
    steps: int,
) -> NDArray[np.int64]:
    """Number of pixels at each display level of the square-root table, in as many threads as torch may use.

    Args:
        clouds: (population, channel, pixel) linear light.
        skies: (channel, pixel) likewise.
        weights: (kappa,) shares of the cloud's own light.
        levels: level of each step of the square root of a value.
        steps: number of steps between 0 and 1.

    Returns:
        (population, kappa, channel, bin).
    """
    counts = np.zeros((len(clouds), len(weights), len(skies), 256), np.int64)
    run_in_threads(
        lambda first, last: _count(clouds, skies, weights, levels, np.float32(steps), counts, first, last),
        len(clouds) * len(skies),
        1,
    )
    return counts
