import math

import pytest
import torch

from render.camera import direction_from_angles
from render.errors import ParameterError
from render.shafts.casters import make_ground, make_sphere
from render.shafts.ray_casting import RayCaster, SunRays
from render.shafts.shadow_map import build_shadow_map, light_axes

SUN = direction_from_angles(math.radians(40.0), math.radians(35.0))


def random_points(count: int, seed: int = 5) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return (torch.rand(count, 3, generator=generator) - torch.tensor([0.5, 0.5, 0.0])) * torch.tensor(
        [60.0, 60.0, 20.0]
    )


@pytest.mark.parametrize("elevation_deg", [5.0, 35.0, 89.9, 90.0, -20.0])
def test_the_map_agrees_with_rays(elevation_deg: float) -> None:
    sun = direction_from_angles(math.radians(40.0), math.radians(elevation_deg))
    caster = RayCaster((make_sphere((0.0, 0.0, 10.0), 4.0), make_ground(25.0)))
    points = random_points(20_000)
    exact = SunRays(caster, sun).look_up_lit(points)
    fine, coarse = (
        float((build_shadow_map(caster, sun, size).look_up_lit(points) != exact).float().mean()) for size in (1024, 32)
    )
    assert fine < 2e-3
    assert coarse >= fine
    assert float(exact.float().mean()) > 0.01
    turned = build_shadow_map(caster, direction_from_angles(2.0, math.radians(30.0)), 1024)
    assert float((turned.look_up_lit(points) != exact).float().mean()) > 0.01


def test_a_region_sharpens_the_map_and_changes_no_answer_in_it() -> None:
    caster = RayCaster((make_sphere((0.0, 0.0, 10.0), 4.0), make_ground(2000.0)))
    region = random_points(3000)
    whole, part = build_shadow_map(caster, SUN, 256), build_shadow_map(caster, SUN, 256, region)
    assert part.texel < 0.2 * whole.texel
    exact = SunRays(caster, SUN).look_up_lit(region)
    wrong = [float((shadows.look_up_lit(region) != exact).float().mean()) for shadows in (whole, part)]
    assert wrong[1] < 0.003
    assert wrong[0] > 2.0 * wrong[1]


def test_nothing_to_cast_is_all_light() -> None:
    points = random_points(50)
    assert build_shadow_map(RayCaster(()), SUN, 64).look_up_lit(points).all()
    caster = RayCaster((make_sphere((0.0, 0.0, 0.0), 1.0),))
    assert build_shadow_map(caster, SUN, 64, points + 1000.0).look_up_lit(points + 1000.0).all()
    with pytest.raises(ParameterError, match="at least one texel"):
        build_shadow_map(caster, SUN, 0)


def test_a_triangle_on_edge_makes_a_map() -> None:
    caster = RayCaster((make_ground(10.0),))
    level = build_shadow_map(caster, (0.0, 1.0, 0.0), 64)
    assert level.look_up_lit(torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])).all()


def test_the_axes_are_right_handed_and_face_the_sun() -> None:
    for sun in (SUN, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)):
        axes = light_axes(sun)
        torch.testing.assert_close(axes @ axes.T, torch.eye(3, dtype=torch.float64), atol=1e-12, rtol=0.0)
        torch.testing.assert_close(torch.linalg.cross(axes[0], axes[1]), axes[2])
        torch.testing.assert_close(axes[2], torch.tensor(sun, dtype=torch.float64))
