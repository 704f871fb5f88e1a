import math

import torch

from render.shafts.casters import make_ground, make_sphere
from render.shafts.ray_casting import PointRays, RayCaster, SunRays

UP = torch.tensor([0.0, 0.0, 1.0])


def test_distances_and_normals_are_those_of_a_sphere() -> None:
    caster = RayCaster((make_sphere((0.0, 0.0, 0.0), 2.0, 128, (0.1, 0.2, 0.3)),))
    origin = torch.tensor([[0.0, -10.0, 0.0], [0.0, -10.0, 1.0], [0.0, -10.0, 3.0]])
    north = torch.tensor([0.0, 1.0, 0.0]).expand_as(origin)
    hits = caster.find_surface(origin, north)
    torch.testing.assert_close(hits.distance, torch.tensor([8.0, 10.0 - math.sqrt(3.0), math.inf]), atol=5e-3, rtol=0.0)
    torch.testing.assert_close(hits.normal[0], torch.tensor([0.0, -1.0, 0.0]), atol=0.03, rtol=0.0)
    torch.testing.assert_close(hits.albedo, torch.tensor([[0.1, 0.2, 0.3], [0.1, 0.2, 0.3], [0.0, 0.0, 0.0]]))
    torch.testing.assert_close(caster.find_distance(origin, north), hits.distance)
    assert torch.equal(hits.normal[2], torch.zeros(3))


def test_a_surface_faces_whoever_looks() -> None:
    caster = RayCaster((make_ground(5.0),))
    origin = torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0]])
    normal = caster.find_surface(origin, torch.stack([-UP, UP])).normal
    torch.testing.assert_close(normal, torch.stack([UP, -UP]))


def test_occlusion_ends_at_the_distance() -> None:
    caster = RayCaster((make_ground(5.0, 1.0),))
    origin = torch.zeros(2, 3)
    assert caster.find_occluded(origin, UP.expand(2, 3), torch.tensor([0.9, 1.1])).tolist() == [False, True]


def test_an_empty_scene_hides_nothing() -> None:
    caster = RayCaster(())
    assert caster.empty
    assert torch.isinf(caster.find_distance(torch.zeros(3, 3), UP.expand(3, 3))).all()
    assert torch.isinf(caster.find_surface(torch.zeros(3, 3), UP.expand(3, 3)).distance).all()
    assert not caster.find_occluded(torch.zeros(1, 3), UP[None], torch.tensor([1e9])).any()


def test_shadow_rays_of_sun_and_lamp() -> None:
    caster = RayCaster((make_sphere((0.0, 0.0, 5.0), 1.0),))
    points = torch.tensor([[[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]], [[0.0, 0.0, 8.0], [0.0, 0.0, 5.0]]])
    assert SunRays(caster, (0.0, 0.0, 1.0)).look_up_lit(points).tolist() == [[False, True], [True, False]]
    assert PointRays(caster, (0.0, 0.0, 10.0)).look_up_lit(points).tolist() == [[False, True], [True, False]]
    inside = PointRays(caster, (0.0, 0.0, 5.0))
    assert inside.look_up_lit(torch.tensor([[0.0, 0.0, 5.5], [0.0, 0.0, 5.0], [0.0, 0.0, 7.0]])).tolist() == [
        True,
        True,
        False,
    ]


def test_no_rays_are_no_answers() -> None:
    caster = RayCaster((make_ground(5.0),))
    assert len(caster.find_distance(torch.zeros(0, 3), torch.zeros(0, 3))) == 0
    assert len(caster.find_surface(torch.zeros(0, 3), torch.zeros(0, 3)).distance) == 0
