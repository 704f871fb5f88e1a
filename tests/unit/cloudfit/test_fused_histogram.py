"""The fused counting of hazes is that of the blocks, bit by bit."""

import pytest
import torch

pytest.importorskip("numba")

from cloudfit import fused_histogram
from cloudfit.colour_histogram import LEVELS, haze_histograms
from cloudfit.fused_histogram import BLOCK
from render.fused import fused_loops_wanted, torch_loops_only

pytestmark = pytest.mark.skipif(not fused_loops_wanted(), reason="the fused loops are turned off")


def light(*shape: int, seed: int = 0) -> torch.Tensor:
    """Linear light, some of it beyond the display at either end."""
    return 1.4 * torch.rand(shape, generator=torch.Generator().manual_seed(seed)) ** 2 - 0.1


def both(
    cloud: torch.Tensor, sky: torch.Tensor, weights: torch.Tensor, curve: str
) -> tuple[torch.Tensor, torch.Tensor]:
    with torch_loops_only():
        plain = haze_histograms(cloud, sky, weights, curve)
    return haze_histograms(cloud, sky, weights, curve), plain


@pytest.mark.parametrize("pixels", [1, 7, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK + 5])
@pytest.mark.parametrize("curve", ["srgb", "none"])
def test_counts_are_those_of_the_blocks(pixels: int, curve: str) -> None:
    cloud, sky = light(2, 3, pixels), light(3, pixels, seed=1)
    weights = torch.rand(2, 5, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    weights[:, 0], weights[:, 1] = 0.0, 1.0
    fused, plain = both(cloud, sky, weights, curve)
    assert fused.shape == (2, 5, 3, LEVELS)
    assert torch.equal(fused, plain)
    assert not torch.equal(fused, both(cloud, sky, weights.flip(1), curve)[1])


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_values_that_are_not_finite_spoil_their_channel_alone(value: float) -> None:
    cloud, sky = light(2, 3, 50), light(3, 50, seed=1)
    cloud[1, 2, 7] = value
    fused, plain = both(cloud, sky, torch.full((2, 1, 3), 0.5, dtype=torch.float64), "srgb")
    assert fused[1, :, 2].isnan().all()
    assert int(fused.isnan().sum()) == LEVELS
    torch.testing.assert_close(fused, plain, rtol=0.0, atol=0.0, equal_nan=True)


@pytest.mark.parametrize("threads", [1, 2])
def test_threads_are_no_part_of_the_result(threads: int) -> None:
    cloud, sky = light(4, 3, 500), light(3, 500, seed=1)
    weights = torch.full((4, 2, 3), 0.3, dtype=torch.float64)
    expected = haze_histograms(cloud, sky, weights)
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        assert torch.equal(haze_histograms(cloud, sky, weights), expected)
    finally:
        torch.set_num_threads(before)
    torch.testing.assert_close(expected.sum(-1), torch.ones(4, 2, 3, dtype=torch.float64))


def test_they_are_used_where_they_are_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    count = fused_histogram.count_hazes

    def noted(*arguments):  # type: ignore[no-untyped-def]
        calls.append(1)
        return count(*arguments)

    monkeypatch.setattr(fused_histogram, "count_hazes", noted)
    both(light(1, 3, 9), light(3, 9), torch.ones(1, 1, 3, dtype=torch.float64), "srgb")
    assert calls == [1]
