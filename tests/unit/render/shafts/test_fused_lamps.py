import math
from dataclasses import replace

import numpy as np
import pytest

from render.fused import fused_loops_wanted
from render.shafts.cube_shadow_map import CubeShadowMap
from render.shafts.lights import Lighting
from tests.support.shaft_scenes import small_scene, small_stage

if not fused_loops_wanted():
    pytest.skip("needs numba", allow_module_level=True)

from render.shafts.fused_lamps import angle_of_step, arc, find_nearest, lamp_arrays


def test_the_angle_of_a_step_at_a_lamp() -> None:
    for first, last, h in ((-5.0, -4.0, 0.1), (-1.0, 2.0, 0.3), (0.0, 1e-3, 2.0), (-1e3, 1e3, 0.05), (0.5, 40.0, 1.0)):
        wanted = math.atan2(last, h) - math.atan2(first, h)
        assert angle_of_step(first, last, h) == pytest.approx(wanted, rel=1e-7)
    assert angle_of_step(-1.0, 2.0, 0.3) != pytest.approx(angle_of_step(-1.0, 2.0, 0.4), rel=0.01)


def test_the_arc_is_smooth_where_the_series_ends() -> None:
    for x in (1e-6, 0.1, 0.1499, 0.1501, 3.0):
        assert arc(x) == pytest.approx(math.atan(x) / x, rel=1e-9)


def test_where_a_ray_is_nearest_to_a_lamp() -> None:
    lamps = np.array([[3.0, 4.0, 0.0, 1.0, 1.0, 1.0, 0.5, np.inf]])
    rays, closest = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]], np.float32), np.zeros((1, 3))
    find_nearest(lamps, 0, rays, 0, 1.0, closest)
    assert closest[0] == pytest.approx([3.0, math.sqrt(16.25), math.sqrt(16.25 + 4.0)])


def test_lamps_and_their_maps_stand_in_rows() -> None:
    scene = small_scene()
    stage = small_stage(replace(scene, lights=(scene.lights[0], replace(scene.lights[0], radius=0.2, reach=9.0))))
    rows, cubes = lamp_arrays(stage.lighting)
    assert rows[0] == pytest.approx([-9.0, -8.0, 5.0, 60.0, 50.0, 30.0, 0.05, np.inf])
    assert rows[1, 6:] == pytest.approx([0.2, 9.0])
    seen = stage.lighting.points[0].visibility
    assert isinstance(seen, CubeShadowMap)
    assert np.array_equal(cubes[0], seen.distances.numpy())
    assert lamp_arrays(Lighting())[0].shape == (0, 8)
