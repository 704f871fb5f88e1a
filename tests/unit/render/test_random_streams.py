"""Streams that depend on their key alone and have nothing in common."""

import pytest
import torch
from scipy import stats

from render.random_streams import child_generator

KEYS = [(7, 0, 0), (7, 0, 1), (7, 1, 0), (8, 0, 0), (0, 7, 0), (7, 4, 256), (7, 256, 4), (1 << 40, 0, 0)]


def numbers(*key: int, count: int = 1000) -> torch.Tensor:
    return torch.rand(count, generator=child_generator(*key))


def test_a_key_gives_one_stream() -> None:
    assert torch.equal(numbers(3, 1, 2), numbers(3, 1, 2))


def test_other_keys_give_other_streams() -> None:
    streams = torch.stack([numbers(*key) for key in KEYS])
    correlation = torch.corrcoef(streams) - torch.eye(len(KEYS))
    # Of 28 pairs of independent streams one exceeds 4.5 standard deviations with probability 2e-4.
    assert correlation.abs().max() < 4.5 / 1000**0.5
    assert torch.corrcoef(torch.stack([numbers(*KEYS[0]), numbers(*KEYS[0])])).min() > 0.999


def test_neighbouring_keys_are_uniform_together() -> None:
    first = torch.stack([numbers(0, 1, batch, count=1)[0] for batch in range(2000)])
    assert stats.kstest(first.numpy(), "uniform").pvalue > 1e-3
    assert stats.kstest(first.square().numpy(), "uniform").pvalue < 1e-3


def test_no_other_stream_is_touched() -> None:
    before = torch.get_rng_state()
    numbers(1, 2)
    assert torch.equal(torch.get_rng_state(), before)


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ValueError, match="non-negative"):
        child_generator(-1)
