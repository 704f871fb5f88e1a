import math

import numpy as np
import pytest
import torch

from render.fused import fused_loops_wanted
from render.shafts.cube_shadow_map import CubeShadowMap
from render.shafts.shadow_map import ShadowMap
from tests.support.shaft_scenes import small_stage

if not fused_loops_wanted():
    pytest.skip("needs numba", allow_module_level=True)

from render.shafts.fused_shadows import lamp_line, lamp_share, sees_lamp, sees_sun, sun_line, sun_share, turn_by


def test_look_ups_are_those_of_the_maps() -> None:
    lighting = small_stage().lighting
    assert lighting.sun is not None
    sun, cube = lighting.sun.visibility, lighting.points[0].visibility
    assert isinstance(sun, ShadowMap)
    assert isinstance(cube, CubeShadowMap)
    points = (torch.rand(3000, 3, generator=torch.Generator().manual_seed(3)) - 0.3) * torch.tensor([40.0, 40.0, 20.0])
    place = ((points @ sun.axes.T)[:, :2] - sun.lower) / sun.texel
    height = (points @ sun.axes.T)[:, 2]
    tops, cubes = sun.tops.numpy(), cube.distances.numpy()[None]
    found = [sees_sun(tops, float(u), float(v), float(w)) for (u, v), w in zip(place, height, strict=True)]
    assert np.mean(np.array(found) != sun.look_up_lit(points).numpy()) < 1e-3
    offsets = (points - cube.position).double().tolist()
    near = [sees_lamp(cubes, 0, *offset, 1.0) for offset in offsets]
    assert np.mean(np.array(near) != cube.look_up_lit(points).numpy()) < 1e-3
    assert 0.02 < np.mean(found) < 0.98
    assert 0.02 < np.mean(near) < 0.98


def test_the_border_of_a_shadow_is_halved_in() -> None:
    # One row of texels: a top at place 3 of the third axis from texel 2 on.
    tops = np.array([[-np.inf, -np.inf, 3.0, 3.0]], np.float32)
    line = (0.0, 0.5, 0.0, 1.0, 0.0, 0.0)
    assert sun_share(tops, line, 0.0, 3.9, 1, 12) == pytest.approx(2.0 / 3.9, abs=1e-3)
    assert sun_share(tops, line, 0.0, 3.9, 1, 0) == 1.0
    assert sun_share(tops, line, 0.5, 2.0, 4, 12) == pytest.approx(0.75, abs=1e-3)
    assert sun_share(tops, line, 0.0, 4.0, 8, 0) == 0.5
    backwards = (3.99, 0.5, 0.0, -1.0, 0.0, 0.0)
    assert sun_share(tops, backwards, 1.0, 2.0, 1, 12) == pytest.approx(0.505, abs=1e-3)


def test_lines_are_rays_in_the_frame_of_the_light() -> None:
    rays = np.array([[1.0, 2.0, 3.0, 0.0, 0.6, 0.8]], np.float32)
    frame = np.hstack([2.0 * np.eye(3), [[1.0], [1.0], [1.0]]])
    assert sun_line(frame, rays, 0) == pytest.approx((3.0, 5.0, 7.0, 0.0, 1.2, 1.6), abs=1e-6)
    lamps = np.array([[1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.1, np.inf]])
    assert lamp_line(lamps, 0, rays, 0, 0.0) == pytest.approx((0.0, 1.0, 2.0, 0.0, 0.6, 0.8), abs=1e-6)
    assert lamp_line(lamps, 0, rays, 0, 5.0) == pytest.approx((0.0, 4.0, 6.0, 0.0, 0.6, 0.8), abs=1e-6)


def test_an_offset_may_be_scaled() -> None:
    wall = np.full((1, 6, 1, 1), 2.0, np.float32)
    assert sees_lamp(wall, 0, 1.9, 0.0, 0.0, 1.0)
    assert not sees_lamp(wall, 0, 2.1, 0.0, 0.0, 1.0)
    assert sees_lamp(wall, 0, 0.19, 0.0, 0.0, 0.01)
    assert not sees_lamp(wall, 0, 0.21, 0.0, 0.0, 0.01)


@pytest.mark.parametrize(("count", "halvings"), [(2, 12), (1, 12), (400, 0)])
def test_the_lit_share_of_a_lamp_is_that_of_the_angle(count: int, halvings: int) -> None:
    # A ball of light of radius 2 around a lamp that the ray passes at 1: the ray is lit up to an angle of 60 degrees.
    wall = np.full((1, 6, 1, 1), 2.0, np.float32)
    line, end = (0.0, 1.0, 0.0, 1.0, 0.0, 0.0), math.atan(9.0)
    share = lamp_share(wall, 0, line, 1.0, 0.0, 1.0, end, count, halvings)
    assert share == pytest.approx(math.pi / 3.0 / end, abs=2e-3)
    assert abs(math.sqrt(3.0) / 9.0 - math.pi / 3.0 / end) > 0.3
    begin = math.radians(30.0)
    share = lamp_share(wall, 0, line, 1.0, math.sin(begin), math.cos(begin), end - begin, count, halvings)
    assert share == pytest.approx((math.pi / 3.0 - begin) / (end - begin), abs=2e-3)


def test_turns_are_cosines_and_sines() -> None:
    for angle in (0.0, 1e-3, 0.3, 0.4999, 0.5001, 2.0):
        assert turn_by(angle) == pytest.approx((math.cos(angle), math.sin(angle)), abs=1e-10)
