"""Streams that depend on their key alone and have nothing in common."""

import numpy as np
import pytest
import torch
from scipy import stats

from render.random_streams import child_generator, counter_keys, counter_uniform, stream_number

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


WORD = (1 << 64) - 1


def split_mix(state: int) -> int:
    """The finaliser as printed in the article, on whole numbers without sign."""
    state = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & WORD
    state = ((state ^ (state >> 27)) * 0x94D049BB133111EB) & WORD
    return state ^ (state >> 31)


def split_mix_uniform(stream: int, counter: int, dimension: int) -> float:
    key = split_mix((stream + (counter + 1) * 0x9E3779B97F4A7C15) & WORD)
    bits = split_mix((key + (dimension + 1) * 0x9E3779B97F4A7C15) & WORD)
    return ((bits >> 41) + 0.5) / (1 << 23)


def drawn(seed: int, counters: int, dimensions: int) -> torch.Tensor:
    """Uniform numbers `(dimension, counter)`."""
    keys = counter_keys(stream_number(seed), torch.arange(counters))
    return torch.stack([counter_uniform(keys, dimension) for dimension in range(dimensions)])


def test_the_finaliser_is_that_of_split_mix() -> None:
    """Seed 1234567 of the reference implementation begins with these numbers; java.util.SplittableRandom agrees."""
    states = [(1234567 + n * 0x9E3779B97F4A7C15) & WORD for n in (1, 2)]
    assert [split_mix(state) for state in states] == [6457827717110365317, 3203168211198807973]


@pytest.mark.parametrize("stream", [0, 5, (1 << 62) - 1])
def test_counted_numbers_are_those_of_plain_whole_numbers(stream: int) -> None:
    counters = [0, 1, 2, 77, (1 << 20) - 1, 1 << 44, (1 << 62) + 12345]
    keys = counter_keys(stream, torch.tensor(counters))
    for dimension in (0, 1, 7, 397, 100_000):
        expected = [split_mix_uniform(stream, counter, dimension) for counter in counters]
        assert counter_uniform(keys, dimension).tolist() == expected
        assert counter_uniform(keys, dimension + 1).tolist() != expected


def test_counted_numbers_are_a_pure_function_of_key_and_dimension() -> None:
    whole = drawn(3, 1000, 4)
    keys = counter_keys(stream_number(3), torch.tensor([999, 5, 5, 0]))
    assert torch.equal(counter_uniform(keys, 2), whole[2, [999, 5, 5, 0]])
    assert torch.equal(counter_uniform(keys.reshape(2, 2), 2).flatten(), whole[2, [999, 5, 5, 0]])
    assert not torch.equal(drawn(4, 1000, 4), whole)


def uniform_p_value(values: torch.Tensor) -> float:
    return float(stats.chisquare(np.histogram(values.double().numpy(), 64, (0.0, 1.0))[0]).pvalue)


def test_counted_numbers_are_uniform_over_keys_and_over_dimensions() -> None:
    numbers = drawn(0, 20_000, 8)
    along_dimensions = torch.stack([drawn(0, 20, 2000)[:, n] for n in range(4)])
    p_values = [uniform_p_value(values) for values in (*numbers, *along_dimensions)]
    assert min(p_values) > 1e-4
    assert uniform_p_value(numbers[0].square()) < 1e-10
    # The lowest of the 23 bits are uniform too.
    assert uniform_p_value(numbers[0] * 2.0**12 % 1.0) > 1e-4


def test_counted_numbers_are_independent_between_keys_dimensions_and_streams() -> None:
    first, other = drawn(0, 20_001, 4), drawn(1, 20_001, 4)
    rows = torch.cat([first[:, :-1], first[:2, 1:], other[:2, :-1]]).double()
    correlation = torch.corrcoef(rows) - torch.eye(len(rows), dtype=torch.float64)
    assert float(correlation.abs().max()) < 4.5 / 20_000**0.5
    # Pairs fill the square evenly: a chi-square test sees what a correlation does not.
    for pair in ((rows[0], rows[1]), (rows[2], rows[3]), (rows[0], rows[4]), (rows[0], rows[6])):
        counts = np.histogram2d(*(values.numpy() for values in pair), bins=16, range=[[0.0, 1.0]] * 2)[0]
        assert stats.chisquare(counts.flatten()).pvalue > 1e-4
    same = np.histogram2d(rows[0].numpy(), rows[0].numpy(), bins=16, range=[[0.0, 1.0]] * 2)[0]
    assert stats.chisquare(same.flatten()).pvalue < 1e-10


def test_counted_numbers_stay_inside_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    assert float(drawn(0, 100_000, 1).min()) > 0.0
    assert float(drawn(0, 100_000, 1).max()) < 1.0
    for bits, expected in ((0, 2.0**-24), (-1, 1.0 - 2.0**-24)):
        monkeypatch.setattr("render.random_streams._mix", lambda state, bits=bits: torch.full_like(state, bits))
        assert counter_uniform(torch.zeros(1, dtype=torch.long), 0).item() == expected


def test_streams_have_numbers_of_62_bits_that_differ() -> None:
    numbers = [stream_number(*key) for key in KEYS]
    assert len(set(numbers)) == len(KEYS)
    assert all(0 <= number < 1 << 62 for number in numbers)
    assert stream_number(*KEYS[0]) == numbers[0]
    with pytest.raises(ValueError, match="non-negative"):
        stream_number(-1)
