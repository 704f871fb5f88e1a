"""Scalar directions, phase functions and random numbers against the tensors' own."""

import math

import pytest
import torch

from render.density_grid import DensityGrid
from render.phase_functions import evaluate_phase_function, rotate_direction, sample_phase_cosine
from render.random_streams import counter_keys, counter_uniform, stream_number

pytest.importorskip("numba")

import numpy as np

from render.fused_scattering import GOLDEN, chord, cosine_between, mix, phase, turn, uniform


def vectors(count: int, seed: int = 0) -> torch.Tensor:
    drawn = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed))
    return drawn / drawn.norm(dim=1, keepdim=True)


def scalars(vector: torch.Tensor) -> tuple[np.float32, ...]:
    return tuple(np.float32(component) for component in vector.tolist())


def test_random_numbers_are_those_of_the_counters() -> None:
    stream, counters = stream_number(3, 1), torch.arange(7)
    with np.errstate(over="ignore"):
        keys = [np.uint64(mix(np.uint64(stream) + np.uint64(number + 1) * GOLDEN)) for number in range(7)]
    for dimension in (0, 1, 77):
        expected = counter_uniform(counter_keys(stream, counters), dimension)
        found = torch.tensor([float(uniform(key, dimension)) for key in keys])
        assert torch.equal(found, expected)
        each = counter_uniform(counter_keys(stream, counters), torch.full((7,), dimension))
        assert torch.equal(each, expected)


@pytest.mark.parametrize("asymmetry", [-0.999, -0.5, 0.0, 0.3, 0.9, 0.999])
def test_turns_and_phase_functions(asymmetry: float) -> None:
    directions, draws = vectors(50), torch.rand(2, 50, generator=torch.Generator().manual_seed(1))
    cosine = sample_phase_cosine(torch.full((50,), asymmetry), draws[0])
    expected = rotate_direction(directions, cosine, 2.0 * math.pi * draws[1])
    for number in range(50):
        first, second = (np.float32(draw) for draw in draws[:, number].tolist())
        found = turn(scalars(directions[number]), np.float32(asymmetry), first, second)
        torch.testing.assert_close(torch.tensor(found), expected[number], rtol=1e-4, atol=1e-5)
        between = cosine_between(scalars(directions[number]), scalars(expected[number]))
        assert between == pytest.approx(float(directions[number] @ expected[number]), abs=1e-6)
        density = evaluate_phase_function(torch.tensor(between), asymmetry)
        assert phase(np.float32(between), np.float32(asymmetry)) == pytest.approx(float(density), rel=1e-4)


def test_chords_are_those_of_the_grid() -> None:
    grid = DensityGrid.from_voxel_size(torch.ones(4, 5, 6), (1.0, 2.0, 0.5))
    box = torch.stack([grid.lower, grid.upper, grid.voxel_size]).numpy()
    origins, directions = 6.0 * vectors(200, 2), vectors(200, 3)
    directions[:10, 0] = 0.0
    near, far = grid.intersect(origins, directions)
    for number in range(200):
        found = chord(box, scalars(origins[number]), scalars(directions[number]))
        assert found == pytest.approx((float(near[number]), float(far[number])), rel=1e-5, abs=1e-6)
