"""The fused passes are those in torch."""

import pytest
import torch

pytest.importorskip("numba")

from render.fused import torch_loops_only
from render.random_streams import child_generator
from render.shafts import fused_bilateral
from render.shafts.bilateral import TAP_COUNTS, ReducedFrame, fill_frame


@pytest.mark.parametrize("taps", TAP_COUNTS)
@pytest.mark.parametrize("factor", [1, 3])
def test_they_fill_what_torch_fills(taps: int, factor: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fused_bilateral, "ROWS", 5)
    generator = child_generator(taps)
    depth = (0.3 * torch.randn(41, 53, generator=generator)).exp()
    depth = torch.where(depth > 1.4, torch.inf, depth)
    depth[10:20, 10:30] = 30.0
    depth[15, 15] = 500.0
    frame = ReducedFrame(53, 41, factor)
    marched = torch.rand(len(frame.rows), len(frame.columns), 3, generator=generator)
    found = fill_frame(frame, marched, depth, taps)
    with torch_loops_only():
        expected = fill_frame(frame, marched, depth, taps)
        other = fill_frame(frame, marched.flip(0), depth, taps)
    torch.testing.assert_close(found.image, expected.image, rtol=1e-5, atol=1e-5)
    assert torch.equal(found.unmatched, expected.unmatched)
    assert not torch.allclose(found.image, other.image, atol=1e-2)


def test_double_precision_stays_with_torch() -> None:
    marched = torch.ones(4, 4, 1, dtype=torch.float64)
    assert fill_frame(ReducedFrame(8, 8, 2), marched, torch.ones(8, 8), 4).image.dtype == torch.float64
