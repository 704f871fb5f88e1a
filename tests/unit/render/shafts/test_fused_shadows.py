import numpy as np
import pytest
import torch

from render.fused import fused_loops_wanted
from render.shafts.cube_shadow_map import CubeShadowMap
from render.shafts.shadow_map import ShadowMap
from tests.support.shaft_scenes import small_stage

if not fused_loops_wanted():
    pytest.skip("needs numba", allow_module_level=True)

from render.shafts.fused_shadows import lamp_line, lamp_share, sees_lamp, sees_sun, sun_line, sun_share


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
    near = [sees_lamp(cubes, 0, *offset) for offset in offsets]
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
    assert lamp_line(lamps, 0, rays, 0) == pytest.approx((0.0, 1.0, 2.0, 0.0, 0.6, 0.8), abs=1e-6)
    wall = np.full((1, 6, 1, 1), 2.0, np.float32)
    assert lamp_share(wall, 0, (0.0, 0.0, 0.0, 1.0, 0.0, 0.0), 0.0, 4.0, 2, 12) == pytest.approx(0.5, abs=1e-3)
