import numpy as np
import pytest
import torch
from scipy.stats import wasserstein_distance

from cloudfit.losses import LOSSES
from cloudfit.losses.sorted_quantiles import sample_quantiles, sorted_wasserstein_distance


def test_quantiles_are_ranks() -> None:
    values = torch.tensor([[5.0, 1.0, 3.0, 2.0]])
    assert sample_quantiles(values, 4).tolist() == [[1.0, 2.0, 3.0, 5.0]]
    assert sample_quantiles(values, 2).tolist() == [[2.0, 5.0]]
    assert sample_quantiles(values, 1).tolist() == [[3.0]]
    assert sample_quantiles(values, 8).tolist() == [[1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 5.0, 5.0]]


def test_many_quantiles_skip_no_rank() -> None:
    # More than 2^24 / 2: ranks in float32 would leave some out and repeat others.
    count = 9_000_001
    values = torch.arange(count, dtype=torch.float64)[None]
    assert torch.equal(sample_quantiles(values, count), values)


@pytest.mark.parametrize("sizes", [(400, 400), (400, 1000), (1000, 400)])
def test_scipy_agrees(sizes: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    rendering, photograph = rng.random(sizes[0]) ** 2, 0.2 + 0.7 * rng.random(sizes[1])
    target = sample_quantiles(torch.from_numpy(photograph)[None], sizes[0])
    found = float(sorted_wasserstein_distance(torch.from_numpy(rendering)[None], target))
    expected = 255.0 * wasserstein_distance(rendering, photograph)
    tolerance = 1e-9 if sizes[0] == sizes[1] else 255.0 / (2 * sizes[0]) * 0.7
    assert found == pytest.approx(expected, abs=tolerance)
    assert found > 5.0


@pytest.mark.parametrize("shift", [0.01, -0.05, 0.2])
def test_a_shift_is_the_distance(shift: float) -> None:
    values = 0.3 + 0.4 * torch.rand(2, 500, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    shifted = sorted_wasserstein_distance((values + shift).flip(-1), sample_quantiles(values, 500))
    assert shifted.tolist() == pytest.approx([255.0 * abs(shift)] * 2, rel=1e-9)


def test_its_stand_in_differs_by_rounding_to_levels_alone() -> None:
    generator = torch.Generator().manual_seed(2)
    first, second = (0.9 * torch.rand(1, 4000, generator=generator, dtype=torch.float64) ** power for power in (1, 2))
    exact = sorted_wasserstein_distance(first, sample_quantiles(second, 4000))
    counted = [
        torch.bincount((255 * values[0]).round().long(), minlength=256)[None] / 4000.0 for values in (first, second)
    ]
    assert float((LOSSES["wasserstein"](*counted) - exact).abs()) < 0.05
    assert float(exact) > 10.0
