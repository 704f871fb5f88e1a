"""The fused search finds the stretches of the one in torch, in any order of rays and any number of chunks."""

import pytest
import torch

pytest.importorskip("numba")

from render.shafts import fused_map_slices
from render.shafts.fused_map_slices import find_lit_slice_by_slice
from tests.unit.render.shafts.test_map_slices import STARTS, by_torch, draw_rays, draw_slices, samples


@pytest.mark.parametrize("start", STARTS.values(), ids=STARTS.keys())
@pytest.mark.parametrize("ordered", [True, False])
def test_it_finds_what_torch_finds(start: tuple[float, float], ordered: bool) -> None:
    slices, rays = draw_slices(start), draw_rays(ordered=ordered)
    found, expected = find_lit_slice_by_slice(slices, rays), by_torch(slices, rays)
    assert bool((found.ray.diff() >= 0).all())
    torch.testing.assert_close(found.lit_fraction(), expected.lit_fraction(), rtol=0.0, atol=1e-12)
    places = (torch.arange(50, dtype=torch.float64) + 0.4371) / 50.0
    _, unsure = samples(slices, rays, places)
    assert torch.equal(found.contains(places) | unsure, expected.contains(places) | unsure)
    other = find_lit_slice_by_slice(draw_slices(start, seed=3), rays)
    assert not torch.allclose(other.lit_fraction(), expected.lit_fraction(), atol=1e-3)


def test_chunks_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    slices, rays = draw_slices(STARTS["within"]), draw_rays()
    whole = find_lit_slice_by_slice(slices, rays)
    monkeypatch.setattr(fused_map_slices, "CHUNK", 7)
    parts = find_lit_slice_by_slice(slices, rays)
    assert torch.equal(whole.ray, parts.ray)
    assert torch.equal(whole.start, parts.start)
    assert torch.equal(whole.end, parts.end)
