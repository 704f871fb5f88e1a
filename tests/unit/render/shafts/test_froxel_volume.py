import math

import pytest
import torch

from render.errors import ParameterError
from render.random_streams import child_generator
from render.shafts.froxel_volume import (
    FroxelVolume,
    accumulate_froxels,
    exponential_edges,
    look_up_froxels,
    mean_transmittance,
)


def at(volume: FroxelVolume, column: float, row: float, distance: float) -> tuple[torch.Tensor, torch.Tensor]:
    light, through = look_up_froxels(volume, *(torch.tensor([number]) for number in (column, row, distance)))
    return light[0], through[0]


def fog(extinction: float, cells: int = 8, length: float = 100.0) -> FroxelVolume:
    """Uniform fog whose source is as large as its extinction: its light is 1 - transmittance."""
    uniform = torch.full((cells, 2, 3, 1), extinction)
    return accumulate_froxels(torch.linspace(0.0, length, cells + 1), uniform.expand(-1, -1, -1, 3), uniform)


def draw_volume(cells: int, seed: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = child_generator(seed)
    edges = torch.cat([torch.zeros(1), (torch.rand(cells, generator=generator) + 0.1).cumsum(0)])
    source = torch.rand(cells, 4, 5, 3, generator=generator)
    extinction = 2.0 * torch.rand(cells, 4, 5, 3, generator=generator)
    return edges, source, torch.where(extinction < 0.5, 0.0, extinction)


def march(
    edges: torch.Tensor, source: torch.Tensor, extinction: torch.Tensor, distance: float, fine: int
) -> torch.Tensor:
    """Midpoint rule in each cell up to a distance: slow, plain and without a table; one column of cells `(cell, channel)`."""
    light, depth = torch.zeros(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    for cell in range(len(edges) - 1):
        step = (min(float(edges[cell + 1]), distance) - float(edges[cell])) / fine
        for _ in range(fine if step > 0.0 else 0):
            light += source[cell].double() * step * torch.exp(-depth - 0.5 * step * extinction[cell].double())
            depth += step * extinction[cell].double()
    return light


@pytest.mark.parametrize("extinction", [0.0, 1e-12, 0.03, 100.0])
@pytest.mark.parametrize("distance", [0.0, 3.0, 12.5, 61.0, 100.0, math.inf])
def test_uniform_fog_has_its_closed_form(extinction: float, distance: float) -> None:
    light, through = at(fog(extinction), 1.3, 0.9, distance)
    depth = extinction * min(distance, 100.0)
    assert light.tolist() == pytest.approx([-math.expm1(-depth)] * 3, rel=1e-5, abs=1e-30)
    assert through.tolist() == pytest.approx([math.exp(-depth)], rel=2e-5, abs=1e-30)
    if 0.0 < depth < 10.0:
        assert light[0].item() != pytest.approx(-math.expm1(-1.1 * depth), rel=1e-3, abs=0.0)


@pytest.mark.parametrize("distance", [0.3, 1.7, 4.0, 99.0])
def test_a_column_equals_a_ray_march_through_its_cells(distance: float) -> None:
    edges, source, extinction = draw_volume(9, seed=1)
    volume = accumulate_froxels(edges, source, extinction)
    light, _ = at(volume, 3.5, 2.5, distance)
    exact = march(edges, source[:, 2, 3], extinction[:, 2, 3], min(distance, float(edges[-1])), fine=400)
    assert light.tolist() == pytest.approx(exact.tolist(), rel=1e-5)
    other, _ = at(volume, 2.5, 2.5, distance)
    assert other.tolist() != pytest.approx(exact.tolist(), rel=1e-2)


def test_cells_converge_to_a_medium_that_varies() -> None:
    """Source and extinction x / 100 per metre x: optical depth x^2 / 200, light 1 - exp(-x^2 / 200)."""
    errors = []
    for cells in (8, 16, 32):
        edges = torch.linspace(0.0, 40.0, cells + 1)
        middle = 0.5 * (edges[1:] + edges[:-1]).reshape(-1, 1, 1, 1) / 100.0
        volume = accumulate_froxels(edges, middle, middle)
        light, _ = at(volume, 0.5, 0.5, 21.0)
        errors.append(abs(light.item() + math.expm1(-(21.0**2) / 200.0)))
    assert errors[0] > 2.0 * errors[1] > 3.0 * errors[2]
    assert errors[2] < 1e-3


def test_pixels_between_columns_are_interpolated() -> None:
    edges, source, extinction = draw_volume(3, seed=2)
    volume = accumulate_froxels(edges, source, extinction)
    left, right = at(volume, 1.5, 0.5, 9.0)[0], at(volume, 2.5, 0.5, 9.0)[0]
    assert torch.allclose(at(volume, 1.75, 0.5, 9.0)[0], 0.75 * left + 0.25 * right, atol=1e-6)
    upper, lower = at(volume, 1.5, 1.5, 9.0)[1], at(volume, 1.5, 2.5, 9.0)[1]
    # Depths are interpolated, and the transmittance follows.
    assert torch.allclose(at(volume, 1.5, 2.25, 9.0)[1], upper**0.25 * lower**0.75, atol=1e-6)
    assert torch.equal(at(volume, 0.0, 0.0, 9.0)[0], at(volume, 0.5, 0.5, 9.0)[0])
    assert torch.equal(at(volume, 5.0, 4.0, 9.0)[0], at(volume, 4.5, 3.5, 9.0)[0])


def test_nothing_lies_before_the_first_cell() -> None:
    volume = accumulate_froxels(torch.tensor([5.0, 10.0]), torch.ones(1, 1, 1, 1), torch.ones(1, 1, 1, 1))
    assert at(volume, 0.5, 0.5, 4.0)[0].item() == 0.0
    assert at(volume, 0.5, 0.5, 4.0)[1].item() == 1.0
    assert at(volume, 0.5, 0.5, 6.0)[0].item() == pytest.approx(1.0 - math.exp(-1.0), rel=1e-5)


def test_distances_grow_by_a_constant_factor() -> None:
    edges = exponential_edges(0.1, 1000.0, 8)
    assert (edges[1:] / edges[:-1]).tolist() == pytest.approx([math.sqrt(10.0)] * 8, rel=1e-5)
    assert (float(edges[0]), float(edges[-1])) == (pytest.approx(0.1), 1000.0)


def test_the_mean_transmittance_keeps_its_digits() -> None:
    depth = torch.tensor([0.0, 1e-20, 1e-6, 1.0, 1e30])
    assert mean_transmittance(depth).tolist() == pytest.approx([1.0, 1.0, 1.0 - 5e-7, 1.0 - math.exp(-1.0), 1e-30])


def test_what_does_not_fit_is_refused() -> None:
    edges, ones = torch.tensor([0.0, 1.0]), torch.ones(1, 2, 2, 3)
    with pytest.raises(ParameterError, match="cells need a source"):
        accumulate_froxels(edges, torch.ones(2, 2, 2, 3), ones)
    with pytest.raises(ParameterError, match="cells need a source"):
        accumulate_froxels(edges, ones, torch.ones(1, 2, 2, 2))
    with pytest.raises(ParameterError, match="must rise"):
        accumulate_froxels(torch.tensor([1.0, 1.0]), ones, ones)
    for bad in (-1.0, math.nan, math.inf):
        with pytest.raises(ParameterError, match="extinction"):
            accumulate_froxels(edges, ones, bad * ones)
    with pytest.raises(ParameterError, match="optical depth"):
        accumulate_froxels(torch.tensor([0.0, 100.0]), ones, 1e38 * ones)
    with pytest.raises(ParameterError, match="distance"):
        at(accumulate_froxels(edges, ones, ones), 0.5, 0.5, math.nan)
    with pytest.raises(ParameterError, match="near < far"):
        exponential_edges(0.0, 1.0, 4)
