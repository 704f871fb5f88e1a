"""Independent random streams for pieces of work, so that a result never depends on the order in which they are done."""

import numpy as np
import torch


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
