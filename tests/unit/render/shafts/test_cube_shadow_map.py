import pytest
import torch

from render.errors import ParameterError
from render.shafts.casters import make_box, make_columns, make_sphere
from render.shafts.cube_shadow_map import build_cube_shadow_map, face_directions
from render.shafts.ray_casting import PointRays, RayCaster


def points_around(count: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(8)
    return (torch.rand(count, 3, generator=generator) - 0.5) * 24.0


@pytest.mark.parametrize("position", [(0.5, -0.2, 3.0), (-4.0, 3.0, 0.1)])
def test_the_map_agrees_with_rays(position: tuple[float, float, float]) -> None:
    caster = RayCaster((make_columns(4, 3.0, 0.6, 5.0), make_sphere((0.0, 4.0, -3.0), 1.5)))
    points = points_around(20_000)
    exact = PointRays(caster, position).look_up_lit(points)
    fine, coarse = (
        float((build_cube_shadow_map(caster, position, size).look_up_lit(points) != exact).float().mean())
        for size in (512, 8)
    )
    assert fine < 2e-3
    assert coarse > 4.0 * fine
    moved = build_cube_shadow_map(caster, (4.0, -3.0, 0.0), 512)
    assert float((moved.look_up_lit(points) != exact).float().mean()) > 0.01


def test_each_texel_holds_the_way_that_its_direction_looks() -> None:
    directions = face_directions(4)
    flat = directions.reshape(-1, 3)
    caster = RayCaster((make_box((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),))
    shadows = build_cube_shadow_map(caster, (0.0, 0.0, 0.0), 4)
    wall = 1.0 / flat.abs().amax(1)
    torch.testing.assert_close(shadows.distances.reshape(-1).double(), wall, atol=1e-5, rtol=0.0)
    assert shadows.look_up_lit((0.99 * wall[:, None] * flat).float()).all()
    assert not shadows.look_up_lit((1.01 * wall[:, None] * flat).float()).any()


def test_a_light_inside_a_mesh_stays_inside() -> None:
    caster = RayCaster((make_sphere((0.0, 0.0, 0.0), 2.0),))
    shadows = build_cube_shadow_map(caster, (0.5, 0.0, 0.0), 64)
    assert shadows.look_up_lit(torch.tensor([[0.5, 0.0, 0.0], [-1.0, 0.5, 0.0]])).all()
    assert not shadows.look_up_lit(torch.tensor([[3.0, 0.0, 0.0], [0.0, 0.0, -2.5]])).any()


def test_nothing_to_cast_is_all_light() -> None:
    shadows = build_cube_shadow_map(RayCaster(()), (0.0, 0.0, 0.0), 2)
    assert shadows.look_up_lit(points_around(20)).all()
    with pytest.raises(ParameterError, match="at least one texel"):
        build_cube_shadow_map(RayCaster(()), (0.0, 0.0, 0.0), 0)
