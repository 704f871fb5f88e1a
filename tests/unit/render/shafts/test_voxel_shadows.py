import math

import pytest
import torch

from render.errors import ParameterError
from render.shafts.casters import make_sphere
from render.shafts.ray_casting import PointRays, RayCaster, SunRays
from render.shafts.rays import ViewRays
from render.shafts.voxel_shadows import VoxelCounts, VoxelShadows, build_voxel_shadows
from tests.support.shaft_scenes import small_stage

STAGE = small_stage()
SUN, LAMP = STAGE.scene.sun, STAGE.scene.lights[0]
FINE, COARSE = VoxelCounts(512, 512, 512), VoxelCounts(32, 32, 32)


def grid_of(light: str, counts: VoxelCounts) -> VoxelShadows:
    assert SUN is not None
    if light == "sun":
        return build_voxel_shadows(STAGE.caster, SUN.direction, STAGE.rays, counts, True)
    return build_voxel_shadows(STAGE.caster, LAMP.position, STAGE.rays, counts, False)


@pytest.mark.parametrize("light", ["sun", "lamp"])
def test_voxels_come_near_to_rays_as_they_shrink(light: str) -> None:
    assert SUN is not None
    exact = SunRays(STAGE.caster, SUN.direction) if light == "sun" else PointRays(STAGE.caster, LAMP.position)
    share = torch.linspace(0.01, 0.97, 64)
    points = STAGE.rays.points_at(STAGE.rays.distance[:, None] * share)
    lit = exact.look_up_lit(points)
    assert 0.01 < float((~lit).float().mean()) < 0.9
    wrong = [float((grid_of(light, counts).look_up_lit(points) != lit).float().mean()) for counts in (FINE, COARSE)]
    assert wrong[0] < 0.01
    assert wrong[1] > 2.0 * wrong[0]


def test_beyond_the_first_occluder_all_is_dark() -> None:
    """The cone behind a sphere before a lamp, seen from aside: at the axis, before and behind."""
    caster = RayCaster((make_sphere((0.0, 0.0, 0.0), 1.0, 64),))
    places = torch.tensor([[-2.0, 0.0, 0.0], [2.0, 0.0, 0.0], [4.0, 0.3, 0.0], [4.0, 2.5, 0.0]])
    eye = torch.tensor([0.0, -12.0, 1.0])
    towards = places - eye
    rays = ViewRays(eye.expand(4, 3), torch.nn.functional.normalize(towards, dim=1), 1.1 * towards.norm(dim=1))
    grid = build_voxel_shadows(caster, (-4.0, 0.0, 0.0), rays, VoxelCounts(512, 512, 512), False)
    assert grid.look_up_lit(places).tolist() == [True, False, False, True]


def test_grids_that_cannot_be_are_refused() -> None:
    with pytest.raises(ParameterError, match="at least one voxel"):
        VoxelCounts(0, 1, 1)
    rays = STAGE.rays
    x, y, z = rays.origin[0].tolist()
    apart = ViewRays(rays.origin + torch.arange(len(rays))[:, None], rays.direction, rays.distance)
    with pytest.raises(ParameterError, match="lamp at the eye"):
        build_voxel_shadows(STAGE.caster, (x, y, z), rays, COARSE, False)
    with pytest.raises(ParameterError, match="one eye"):
        build_voxel_shadows(STAGE.caster, (0.0, 0.0, 1.0), apart, COARSE, True)
    assert math.isinf(grid_of("sun", COARSE).light_distance)
