import math

import pytest
import torch

from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.random_streams import child_generator
from render.shafts.participating_media import SpheroidMedium, build_medium_grid
from render.shafts.self_shadowing import DistantLight, Light, NearLight, build_light_lengths, compute_light_length

BLOCK = DensityGrid.from_voxel_size(torch.full((4, 6, 8), 0.5), 10.0, (0.0, 0.0, 0.0))
"""80 m by 60 m by 40 m of density 0.5."""


def towards(*points: tuple[float, float, float], light: Light) -> list[float]:
    return build_light_lengths(BLOCK, light).look_up(torch.tensor(points)).tolist()


def test_a_block_lit_from_above_has_its_thickness() -> None:
    light = DistantLight((0.0, 0.0, 3.0))
    points = ((40.0, 30.0, 40.0), (40.0, 30.0, 30.0), (40.0, 30.0, 1.0), (0.0, 60.0, 0.0), (40.0, 30.0, -90.0))
    assert towards(*points, light=light) == pytest.approx([0.0, 5.0, 19.5, 20.0, 20.0], abs=1e-4)
    assert towards((40.0, 30.0, 50.0), (-0.1, 30.0, 0.0), light=light) == [0.0, 0.0]
    assert towards((40.0, 30.0, 30.0), light=DistantLight((0.0, 0.0, -3.0))) == pytest.approx([15.0], abs=1e-4)


def test_a_slanted_light_takes_the_longer_way() -> None:
    light = DistantLight((1.0, 0.0, 1.0))
    length = compute_light_length(BLOCK, torch.tensor([[20.0, 30.0, 10.0], [70.0, 30.0, 10.0]]), light)
    assert length.tolist() == pytest.approx([15.0 * math.sqrt(2.0), 5.0 * math.sqrt(2.0)], rel=1e-5)


def test_a_lamp_within_the_block_is_as_far_as_it_is() -> None:
    light = NearLight((40.0, 30.0, 20.0))
    points = torch.tensor([[40.0, 30.0, 20.0], [50.0, 30.0, 20.0], [10.0, 30.0, 20.0], [40.0, -70.0, 20.0]])
    assert compute_light_length(BLOCK, points, light).tolist() == pytest.approx([0.0, 5.0, 15.0, 15.0], rel=1e-5)
    assert build_light_lengths(BLOCK, light).look_up(points).tolist() == pytest.approx([0.0, 5.0, 15.0, 15.0], abs=1e-3)


def test_a_lamp_before_the_block_is_not_hidden_by_it() -> None:
    lamp = NearLight((-50.0, 30.0, 20.0))
    points = ((-70.0, 30.0, 20.0), (-20.0, 30.0, 20.0), (-60.0, 30.0, 20.0))
    assert towards(*points, light=lamp) == [0.0, 0.0, 0.0]
    assert towards((90.0, 30.0, 20.0), light=lamp) == pytest.approx([40.0], abs=1e-3)
    assert towards((-70.0, 30.0, 20.0), light=DistantLight((1.0, 0.0, 0.0))) == pytest.approx([40.0], abs=1e-3)


@pytest.mark.parametrize("light", [DistantLight((0.3, -0.4, 0.6)), NearLight((30.0, -60.0, 90.0))])
def test_the_table_converges_to_the_march(light: Light) -> None:
    medium = SpheroidMedium((0.0, 0.0, 0.0), (8.0, 6.0, 3.0), 12, 9.0, seed=4)
    points = 15.0 * torch.randn(500, 3, generator=child_generator(1))
    errors = []
    for resolution in (12, 24, 48):
        grid = build_medium_grid(medium, resolution)
        exact = compute_light_length(grid, points, light, step=0.1)
        errors.append(float((build_light_lengths(grid, light).look_up(points) - exact).square().mean().sqrt()))
    assert float(exact.max()) > 5.0
    assert errors[0] > 2.0 * errors[1] > 4.0 * errors[2]
    assert errors[2] < 0.01 * float(exact.max())


def test_a_light_is_somewhere() -> None:
    with pytest.raises(ParameterError, match="not zero"):
        DistantLight((0.0, 0.0, 0.0))
    with pytest.raises(ParameterError, match="finite"):
        NearLight((0.0, math.inf, 0.0))
    assert compute_light_length(BLOCK, torch.zeros(0, 3), NearLight((0.0, 0.0, 0.0))).shape == (0,)


def test_points_in_double_precision_have_the_same_lengths() -> None:
    points = 15.0 * torch.randn(50, 3, generator=child_generator(1))
    for light in (DistantLight((0.3, -0.4, 0.6)), NearLight((30.0, -60.0, 90.0))):
        table = build_light_lengths(BLOCK, light)
        assert table.look_up(points.double()).dtype == torch.float64
        assert torch.equal(table.look_up(points.double()).float(), table.look_up(points))
        assert torch.equal(
            compute_light_length(BLOCK, points.double(), light).float(), compute_light_length(BLOCK, points, light)
        )
