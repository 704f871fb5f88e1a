"""The fused walk is the one in torch, in every bit, and so is the linear scan."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("numba")

from render.fused import torch_loops_only
from render.random_streams import child_generator
from render.shafts import fused_minmax_tree
from render.shafts.fused_minmax_tree import walk_down
from render.shafts.minmax_tree import SliceRays, build_minmax_tree, find_lit_intervals, scan_lit_intervals
from tests.unit.render.shafts.test_minmax_tree import assert_equal, draw_profiles, draw_rays


def in_precision(rays: SliceRays, dtype: torch.dtype) -> SliceRays:
    ends = (rays.start_place, rays.end_place, rays.start_depth, rays.end_depth)
    return SliceRays(rays.slice_number, *(number.to(dtype) for number in ends))


@given(st.integers(0, 2**32), st.integers(1, 70), st.sampled_from([torch.float32, torch.float64]))
@settings(max_examples=100, deadline=None)
def test_it_equals_the_linear_scan(seed: int, cells: int, dtype: torch.dtype) -> None:
    generator = child_generator(seed)
    profiles = draw_profiles(5, cells, generator).to(dtype)
    edges = (torch.rand(5, cells + 1, generator=generator) * 1.5).cumsum(1).to(dtype) if seed % 2 else None
    rays = in_precision(draw_rays(40, 5, cells, generator), dtype)
    tree = build_minmax_tree(profiles, edges)
    assert_equal(walk_down(tree, rays), scan_lit_intervals(tree, rays))


def test_it_equals_the_walk_in_torch_in_any_number_of_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = child_generator(8)
    tree = build_minmax_tree(draw_profiles(10_000, 37, generator))
    rays = draw_rays(30_000, 10_000, 37, generator)
    with torch_loops_only():
        expected = find_lit_intervals(tree, rays)
    for chunk in (1 << 12, 77):
        monkeypatch.setattr(fused_minmax_tree, "CHUNK", chunk)
        assert_equal(walk_down(tree, rays), expected)
    assert_equal(find_lit_intervals(tree, rays), expected)
    others = build_minmax_tree(draw_profiles(10_000, 37, child_generator(9)))
    assert not torch.equal(walk_down(others, rays).ray, expected.ray)


def test_a_row_of_many_stretches_fits() -> None:
    """Every other cell of 4000 lets the light through: 2000 stretches of one ray."""
    profile = torch.tensor([[0.0, 2.0]]).repeat(1, 2000)
    one = torch.ones(1)
    rays = SliceRays(torch.zeros(1, dtype=torch.int64), 0.0 * one, 4000.0 * one, one, one)
    found = walk_down(build_minmax_tree(profile), rays)
    assert len(found.ray) == 2000
    assert found.lit_fraction().item() == pytest.approx(0.5, rel=1e-5)


def test_no_rays_have_no_light() -> None:
    none = torch.zeros(0)
    found = walk_down(build_minmax_tree(torch.zeros(1, 1)), SliceRays(none.long(), none, none, none, none))
    assert (found.rays, len(found.ray)) == (0, 0)
