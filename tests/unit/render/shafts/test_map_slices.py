import math

import pytest
import torch

from render.errors import ParameterError
from render.fused import torch_loops_only
from render.random_streams import child_generator
from render.shafts.lit_intervals import LitIntervals
from render.shafts.map_slices import MapSlices, cut_map, find_lit_in_map
from render.shafts.minmax_tree import SliceRays

HEADINGS = 97


def draw_map(rows: int = 13, columns: int = 17, seed: int = 1) -> torch.Tensor:
    """Depths with walls before nothing, some of them alike."""
    noise = torch.rand(rows, columns, generator=child_generator(seed))
    return torch.where(noise < 0.5, (6.0 * noise).round() / 6.0, torch.inf)


def draw_slices(start: tuple[float, float], seed: int = 1) -> MapSlices:
    angle = torch.linspace(0.0, 2.0 * math.pi, HEADINGS + 1, dtype=torch.float64)[:-1]
    heading = torch.stack([torch.cos(angle), torch.sin(angle)], dim=1)
    heading[0], heading[HEADINGS // 4] = torch.tensor([1.0, 0.0]), torch.tensor([0.0, 1.0])
    return MapSlices(draw_map(seed=seed), torch.tensor(start, dtype=torch.float64), heading)


def draw_rays(count: int = 3000, seed: int = 2, *, ordered: bool = True) -> SliceRays:
    numbers = torch.rand(4, count, generator=child_generator(seed), dtype=torch.float64)
    number = torch.arange(count) * HEADINGS // count if ordered else torch.arange(count) % HEADINGS
    near = torch.where(numbers[0] < 0.5, 0.0, 10.0 * numbers[0])
    return SliceRays(number, near, torch.where(numbers[0] < 0.1, near, 30.0 * numbers[1]), numbers[2], numbers[3])


def samples(slices: MapSlices, rays: SliceRays, places: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Whether samples are lit by the nearest texel of the map itself `(ray, sample)`, and where rounding may decide that."""
    way = rays.start_place[:, None] + places * (rays.end_place - rays.start_place)[:, None]
    depth = rays.start_depth[:, None] + places * (rays.end_depth - rays.start_depth)[:, None]
    point = slices.start + way[..., None] * slices.heading[rays.slice_number][:, None]
    column, row = point.floor().long().unbind(-1)
    rows, columns = slices.depths.shape
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    known = slices.depths.double()[row.clamp(0, rows - 1), column.clamp(0, columns - 1)]
    unsure = ((point - point.round()).abs() < 1e-9).any(-1) | ((depth - known).abs() < 1e-9)
    return ~inside | (depth <= known), unsure


STARTS = {
    "within": (6.3, 4.8),
    "on a border": (6.0, 4.0),
    "in a corner": (0.0, 0.0),
    "at the far corner": (17.0, 13.0),
    "outside": (-4.2, 5.5),
    "beyond a corner": (24.0, -6.0),
}


def by_torch(slices: MapSlices, rays: SliceRays) -> LitIntervals:
    with torch_loops_only():
        return find_lit_in_map(slices, rays)


@pytest.mark.parametrize("start", STARTS.values(), ids=STARTS.keys())
def test_stretches_are_those_of_the_map(start: tuple[float, float]) -> None:
    slices, rays = draw_slices(start), draw_rays()
    places = (torch.arange(50, dtype=torch.float64) + 0.4371) / 50.0
    expected, unsure = samples(slices, rays, places)
    lit = by_torch(slices, rays).contains(places)
    assert torch.equal(lit | unsure, expected | unsure)
    assert float(unsure.float().mean()) < 0.2
    other = by_torch(draw_slices(start, seed=3), rays).contains(places)
    assert not torch.equal(other | unsure, expected | unsure)


def sphere_map(texels: int) -> torch.Tensor:
    """A sphere of radius 1 in the middle of a map of side 4, seen by parallel light; its middle is at depth 0."""
    centre = (torch.arange(texels, dtype=torch.float64) + 0.5) * (4.0 / texels) - 2.0
    aside = centre.square() + centre[:, None].square()
    return torch.where(aside < 1.0, -(1.0 - aside).clamp(min=0.0).sqrt(), torch.inf)


def rays_by_a_sphere(count: int = 400) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Ends `(ray, 3)` of segments from one eye, and the fractions `(ray, 2)` at which they enter and leave the shadow: x, y, depth.

    Even rays pass behind the sphere and are dark within its cylinder; odd ones come from before it, hit it, and end in its middle plane.
    """
    numbers = torch.rand(3, count, generator=child_generator(5), dtype=torch.float64)
    eye = torch.tensor([-1.9, -1.2, -3.0], dtype=torch.float64)
    ends = torch.stack([1.9 * numbers[0], 4.0 * numbers[1] - 2.0, 6.0 + 60.0 * numbers[2]], dim=1)
    ends[1::2] = torch.stack([0.5 * numbers[0] - 0.2, 0.6 * numbers[1] - 0.3, 0.0 * numbers[2]], dim=1)[1::2]
    way = ends - eye

    def roots(axes: int) -> torch.Tensor:
        a, b = way[:, :axes].square().sum(1), (way[:, :axes] * eye[:axes]).sum(1)
        root = (b * b - a * (eye[:axes].square().sum() - 1.0)).clamp(min=0.0).sqrt()
        return torch.stack([(-b - root) / a, (-b + root) / a], dim=1)

    cylinder, sphere = roots(2).clamp(0.0, 1.0), roots(3)[:, :1]
    dark = torch.where(
        (torch.arange(count) % 2 == 0)[:, None], cylinder, torch.cat([sphere, torch.ones_like(sphere)], 1)
    )
    behind = eye[2] + cylinder[:, 0] * way[:, 2] > 0.0
    kept = behind | (torch.arange(count) % 2 == 1)
    return eye, ends[kept], dark[kept]


@pytest.mark.parametrize("fused", [True, False])
def test_the_shadow_of_a_sphere_has_its_closed_form(fused: bool) -> None:
    eye, ends, dark = rays_by_a_sphere()
    texels = 2048
    flat = (ends - eye)[:, :2]
    length = torch.linalg.vector_norm(flat, dim=1)
    slices = MapSlices(sphere_map(texels), (eye[:2] + 2.0) * (texels / 4.0), flat / length[:, None])
    zero = torch.zeros_like(length)
    rays = SliceRays(torch.arange(len(ends)), zero, length * (texels / 4.0), zero + eye[2], ends[:, 2])
    found = find_lit_in_map(slices, rays) if fused else by_torch(slices, rays)
    lit = 1.0 - (dark[:, 1] - dark[:, 0])
    assert len(ends) > 250
    assert 0.1 < float(lit.mean()) < 0.95
    error = found.lit_fraction() - lit
    # A ray that grazes the sphere sees a texel more or less of it along a chord of the square root of a texel.
    assert float(error.square().mean().sqrt()) < 1e-3
    assert float(error.abs().median()) < 5e-4
    larger = MapSlices(sphere_map(texels).roll(20, 1), slices.start, slices.heading)
    assert float((find_lit_in_map(larger, rays).lit_fraction() - lit).square().mean().sqrt()) > 3e-3


def test_cells_end_at_the_borders_of_texels() -> None:
    slices = MapSlices(torch.tensor([[1.0, 2.0, 3.0]]), torch.tensor([0.5, 0.5]), torch.tensor([[1.0, 0.0]]))
    depths, edges = cut_map(slices, 10.0)
    long = edges.diff() > 0.0
    assert depths[long].tolist() == [1.0, 2.0, 3.0, math.inf]
    assert edges[0, 1:][long[0]].tolist() == [0.5, 1.5, 2.5, 10.0]


def test_what_is_no_map_is_refused() -> None:
    slices, rays = draw_slices((1.0, 1.0)), draw_rays(9)
    with pytest.raises(ParameterError, match="NaN"):
        MapSlices(torch.full((2, 2), math.nan), slices.start, slices.heading)
    with pytest.raises(ParameterError, match="headings"):
        MapSlices(slices.depths, slices.start, slices.heading[:, :1])
    with pytest.raises(ParameterError, match="behind the eye"):
        find_lit_in_map(slices, SliceRays(rays.slice_number, *[-rays.end_place - 1.0] * 2, *[rays.end_depth] * 2))
    with pytest.raises(ParameterError, match="there are 97 slices"):
        find_lit_in_map(slices, SliceRays(rays.slice_number + 97, *[rays.end_place] * 2, *[rays.end_depth] * 2))
    none = torch.zeros(0, dtype=torch.float64)
    assert find_lit_in_map(slices, SliceRays(none.long(), none, none, none, none)).rays == 0
