"""Independent random streams for pieces of work, so that a result never depends on the order in which they are done."""

import numpy as np
import torch
from torch import Tensor


def child_generator(seed: int, *key: int, device: torch.device | str = "cpu") -> torch.Generator:
    """Generator for one piece of the work that `seed` starts.

    Args:
        seed: of the whole computation, any non-negative integer.
        key: numbers that name the piece, for example stage and chunk.
        device: of the generator.

    Returns:
        A generator whose stream is independent of that of every other key of the same length (numpy's SeedSequence hashes
        them, and fills short ones up with zeros).
    """
    state = np.random.SeedSequence([seed, *key]).generate_state(2, np.uint32)
    generator = torch.Generator(device=device)
    generator.manual_seed(int(state[0]) << 31 ^ int(state[1]))
    return generator


GOLDEN_RATIO = 0x9E3779B97F4A7C15
FIRST_FACTOR = 0xBF58476D1CE4E5B9
SECOND_FACTOR = 0x94D049BB133111EB
"""Constants of SplitMix64 (Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators")."""


def stream_number(seed: int, *key: int) -> int:
    """A 62-bit number that names a random stream, for `counter_keys`; see `child_generator` for the arguments."""
    state = np.random.SeedSequence([seed, *key]).generate_state(2, np.uint32)
    return int(state[0]) << 30 ^ int(state[1])


def counter_keys(stream: int, counter: Tensor) -> Tensor:
    """One key for each of the numbered things that draw random numbers of their own, whatever is drawn beside them.

    Args:
        stream: from `stream_number`.
        counter: numbers of the things, int64, any shape.

    Returns:
        Keys, int64 of the same shape.
    """
    return _mix(stream + (counter + 1) * _signed(GOLDEN_RATIO))


def counter_uniform(keys: Tensor, dimension: int | Tensor) -> Tensor:
    """Uniform random numbers inside (0, 1), a pure function of key and dimension.

    The middle of one of 2^23 equal cells, so neither a logarithm nor a division by it needs a guard.

    Args:
        keys: from `counter_keys`.
        dimension: which random number of each key, from 0; one for all, or int64 of the same shape.

    Returns:
        float32 of the same shape.
    """
    if isinstance(dimension, int):
        bits = _mix(keys + _signed((dimension + 1) * GOLDEN_RATIO))
    else:
        bits = _mix(keys + (dimension + 1) * _signed(GOLDEN_RATIO))
    return (_shift(bits, 41).to(torch.float32) + 0.5) * 2.0**-23


def _mix(state: Tensor) -> Tensor:
    """Finaliser of SplitMix64; int64 arithmetic wraps like that of uint64."""
    state = (state ^ _shift(state, 30)) * _signed(FIRST_FACTOR)
    state = (state ^ _shift(state, 27)) * _signed(SECOND_FACTOR)
    return state ^ _shift(state, 31)


def _shift(state: Tensor, places: int) -> Tensor:
    """Shift right that fills up with zeros; torch's own repeats the sign."""
    return (state >> places) & ((1 << (64 - places)) - 1)


def _signed(constant: int) -> int:
    """The int64 with the lowest 64 bits of a number."""
    wrapped = constant & ((1 << 64) - 1)
    return wrapped - (1 << 64) if wrapped >= 1 << 63 else wrapped
