import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from render.errors import ParameterError
from render.fused import torch_loops_only
from render.random_streams import child_generator
from render.shafts.lit_intervals import LitIntervals
from render.shafts.minmax_tree import SliceRays, build_minmax_tree, find_lit_intervals, scan_lit_intervals


def ray(start: tuple[float, float], end: tuple[float, float], slice_number: int = 0) -> SliceRays:
    """One ray from (place, depth) to (place, depth)."""
    numbers = (torch.tensor([number]) for number in (start[0], end[0], start[1], end[1]))
    return SliceRays(torch.tensor([slice_number]), *numbers)


def stretches(intervals: LitIntervals) -> list[tuple[float, float]]:
    return [
        (pytest.approx(s, abs=1e-6), pytest.approx(e, abs=1e-6))
        for s, e in zip(intervals.start.tolist(), intervals.end.tolist(), strict=True)
    ]


def assert_equal(found: LitIntervals, expected: LitIntervals) -> None:
    assert torch.equal(found.ray, expected.ray)
    assert torch.equal(found.start, expected.start)
    assert torch.equal(found.end, expected.end)
    assert found.rays == expected.rays


def draw_rays(count: int, slices: int, cells: int, generator: torch.Generator) -> SliceRays:
    """Rays of all kinds: across and beyond the map, backwards, along the light, on edges, at the very depth of a cell."""
    numbers = torch.rand(4, count, generator=generator) * (cells + 4.0) - 2.0
    kind = torch.randint(0, 6, (count,), generator=generator)
    start_place, end_place, start_depth, end_depth = numbers
    start_depth, end_depth = (start_depth + 2.0) / (cells + 4.0), (end_depth + 2.0) / (cells + 4.0)
    end_place = torch.where(kind == 0, start_place, end_place)
    end_depth = torch.where(kind == 1, start_depth, end_depth)
    on_grid = (kind == 2) | (kind == 3)
    start_place = torch.where(on_grid, start_place.round(), start_place)
    end_place = torch.where(on_grid, end_place.round(), end_place)
    start_depth = torch.where(kind == 3, (4.0 * start_depth).round() / 4.0, start_depth)
    end_depth = torch.where(kind == 3, (4.0 * end_depth).round() / 4.0, end_depth)
    return SliceRays(torch.arange(count) % slices, start_place, end_place, start_depth, end_depth)


def draw_profiles(slices: int, cells: int, generator: torch.Generator) -> torch.Tensor:
    """Steps, noise, walls before an empty background, and depths that repeat."""
    noise = torch.rand(slices, cells, generator=generator)
    kind = torch.randint(0, 4, (slices, 1), generator=generator)
    smooth = noise.cumsum(1) / torch.arange(1, cells + 1)
    walls = torch.where(noise < 0.3, noise, torch.inf)
    return torch.where(
        kind == 0, noise, torch.where(kind == 1, smooth, torch.where(kind == 2, walls, (4.0 * noise).round() / 4.0))
    )


def test_a_wall_casts_its_shadow() -> None:
    """A level ray at depth 0.5 over four cells whose second holds a wall at depth 0.2."""
    tree = build_minmax_tree(torch.tensor([[math.inf, 0.2, math.inf, 0.5]]))
    found = find_lit_intervals(tree, ray((0.0, 0.5), (4.0, 0.5)))
    assert stretches(found) == [(0.0, 0.25), (0.5, 1.0)]
    assert found.lit_fraction().item() == pytest.approx(0.75)
    deeper = find_lit_intervals(tree, ray((0.0, 0.6), (4.0, 0.6)))
    assert stretches(deeper) == [(0.0, 0.25), (0.5, 0.75)]


def test_a_ray_passes_the_depth_of_a_cell_where_it_should() -> None:
    tree = build_minmax_tree(torch.tensor([[0.5, 0.5]]))
    assert stretches(find_lit_intervals(tree, ray((0.0, 0.0), (2.0, 2.0)))) == [(0.0, 0.25)]
    assert stretches(find_lit_intervals(tree, ray((2.0, 2.0), (0.0, 0.0)))) == [(0.75, 1.0)]
    assert stretches(find_lit_intervals(tree, ray((1.5, 0.0), (1.5, 2.0)))) == [(0.0, 0.25)]


def test_outside_of_the_map_is_lit_and_inside_is_not() -> None:
    tree = build_minmax_tree(torch.full((1, 3), -math.inf))
    assert stretches(find_lit_intervals(tree, ray((-1.0, 0.0), (4.0, 0.0)))) == [(0.0, 0.2), (0.8, 1.0)]
    assert stretches(find_lit_intervals(tree, ray((5.0, 0.0), (9.0, 0.0)))) == [(0.0, 1.0)]
    assert not stretches(find_lit_intervals(tree, ray((0.0, 0.0), (3.0, 0.0))))


def test_cells_of_other_widths() -> None:
    tree = build_minmax_tree(torch.tensor([[0.0, 1.0]]), torch.tensor([[0.0, 30.0, 40.0]]))
    assert stretches(find_lit_intervals(tree, ray((0.0, 0.5), (40.0, 0.5)))) == [(0.75, 1.0)]
    even = build_minmax_tree(torch.tensor([[0.0, 1.0]]), torch.tensor([[0.0, 20.0, 40.0]]))
    assert stretches(find_lit_intervals(even, ray((0.0, 0.5), (40.0, 0.5)))) == [(0.5, 1.0)]


def test_each_ray_sees_its_own_slice() -> None:
    tree = build_minmax_tree(torch.tensor([[0.0], [1.0]]))
    assert not len(find_lit_intervals(tree, ray((0.0, 0.5), (1.0, 0.5), slice_number=0)).ray)
    assert len(find_lit_intervals(tree, ray((0.0, 0.5), (1.0, 0.5), slice_number=1)).ray) == 1


@given(st.integers(0, 2**32), st.integers(1, 70), st.sampled_from([torch.float32, torch.float64]))
@settings(max_examples=60, deadline=None)
def test_the_tree_equals_the_linear_scan(seed: int, cells: int, dtype: torch.dtype) -> None:
    generator = child_generator(seed)
    profiles = draw_profiles(5, cells, generator).to(dtype)
    edges = (torch.rand(5, cells + 1, generator=generator) * 1.5).cumsum(1).to(dtype) if seed % 2 else None
    rays = draw_rays(40, 5, cells, generator)
    rays = SliceRays(
        rays.slice_number, *(n.to(dtype) for n in (rays.start_place, rays.end_place, rays.start_depth, rays.end_depth))
    )
    tree = build_minmax_tree(profiles, edges)
    with torch_loops_only():
        assert_equal(find_lit_intervals(tree, rays), scan_lit_intervals(tree, rays))


def test_the_tree_equals_the_linear_scan_on_10_000_profiles() -> None:
    generator = child_generator(6)
    tree = build_minmax_tree(draw_profiles(10_000, 37, generator))
    rays = draw_rays(30_000, 10_000, 37, generator)
    with torch_loops_only():
        found = find_lit_intervals(tree, rays)
    assert_equal(found, scan_lit_intervals(tree, rays))
    assert 0.2 < float(found.lit_fraction().mean()) < 0.8
    assert not bool((found.end <= found.start).any())
    follows = found.ray[1:] == found.ray[:-1]
    assert bool((found.start[1:] > found.end[:-1])[follows].all())


def test_samples_agree_with_the_depth_of_their_cells() -> None:
    """An independent look at single places: between two edges, lit means not deeper than the cell."""
    generator = child_generator(7)
    cells = 23
    profiles = draw_profiles(400, cells, generator).double()
    rays = draw_rays(4000, 400, cells, generator)
    rays = SliceRays(
        rays.slice_number, *(n.double() for n in (rays.start_place, rays.end_place, rays.start_depth, rays.end_depth))
    )
    places = (torch.arange(64, dtype=torch.float64) + 0.437) / 64.0
    place = rays.start_place[:, None] + places * (rays.end_place - rays.start_place)[:, None]
    depth = rays.start_depth[:, None] + places * (rays.end_depth - rays.start_depth)[:, None]
    cell = place.floor().long()
    known = profiles[rays.slice_number[:, None], cell.clamp(0, cells - 1)]
    expected = (depth <= known) | (cell < 0) | (cell >= cells)
    tree = build_minmax_tree(profiles)
    found = find_lit_intervals(tree, rays).contains(places)
    unsure = ((depth - known).abs() < 1e-12) | ((place - place.round()).abs() < 1e-12)
    assert torch.equal(found | unsure, expected | unsure)
    assert not torch.equal(find_lit_intervals(tree, rays).contains(places * 0.99) | unsure, expected | unsure)


def test_what_cannot_be_a_slice_is_refused() -> None:
    with pytest.raises(ParameterError, match="NaN"):
        build_minmax_tree(torch.tensor([[0.0, math.nan]]))
    with pytest.raises(ParameterError, match="shape"):
        build_minmax_tree(torch.zeros(3))
    with pytest.raises(ParameterError, match="3 edges"):
        build_minmax_tree(torch.zeros(1, 2), torch.zeros(1, 2))
    with pytest.raises(ParameterError, match="must not fall"):
        build_minmax_tree(torch.zeros(1, 1), torch.tensor([[1.0, 0.0]]))
    with pytest.raises(ParameterError, match="finite"):
        ray((0.0, 0.0), (math.inf, 0.0))
    with pytest.raises(ParameterError, match="slice 4"):
        find_lit_intervals(build_minmax_tree(torch.zeros(2, 2)), ray((0.0, 0.0), (1.0, 0.0), slice_number=4))


def test_no_rays_have_no_light() -> None:
    none = torch.zeros(0)
    rays = SliceRays(none.long(), none, none, none, none)
    found = find_lit_intervals(build_minmax_tree(torch.zeros(1, 1)), rays)
    assert found.rays == 0
    assert found.lit_fraction().shape == (0,)
