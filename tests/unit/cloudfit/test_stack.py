import math
from pathlib import Path

import pytest
import torch

from cloudfit.parameters import LARGEST_OPTICAL_DEPTH_RANGE
from cloudfit.scene import Scene
from cloudfit.stack import prepare_stack
from render.camera import PinholeCamera
from render.depth_nodes import SOFT_DEPTH, depth_coordinate
from render.errors import CameraError
from tests.support.small_scene import TINY, small_scene, small_stack


def test_the_nodes_span_the_search_box_whatever_the_scale_of_the_volume() -> None:
    tables = small_stack().tables
    depths = tables.extinction * tables.largest_optical_length
    thin, thick = LARGEST_OPTICAL_DEPTH_RANGE
    assert float(depths[0]) == pytest.approx(thin, rel=1e-4)
    assert float(depths[-1]) == pytest.approx(thick, rel=1e-4)
    steps = depth_coordinate(depths, SOFT_DEPTH).diff()
    assert torch.allclose(steps, steps[0].expand_as(steps), rtol=1e-4)
    assert float(tables.soft_extinction) * tables.largest_optical_length == pytest.approx(SOFT_DEPTH)


def test_a_narrow_range_of_depths_has_fewer_nodes_that_span_it() -> None:
    stack, _ = prepare_stack(small_scene(), TINY, 3, optical_depths=(0.01, 0.1))
    depths = stack.tables.extinction * stack.tables.largest_optical_length
    assert len(depths) < len(small_stack().tables.extinction)
    assert float(depths[0]) == pytest.approx(0.01, rel=1e-4)
    assert float(depths[-1]) == pytest.approx(0.1, rel=1e-4)


def test_the_stack_is_smaller_than_the_pictures_by_the_preset() -> None:
    tables, camera = small_stack().tables, small_scene().camera
    assert (tables.width, tables.height) == (camera.width // 2, camera.height // 2)


def test_a_kept_stack_is_loaded_again_and_another_sun_is_not(tmp_path: Path) -> None:
    scene = small_scene()
    first, report = prepare_stack(scene, TINY, 3, tmp_path)
    again, second = prepare_stack(scene, TINY, 3, tmp_path)
    assert (report.reused, second.reused) == (False, True)
    assert torch.equal(first.tables.multiple, again.tables.multiple)
    other = Scene(scene.grid, None, scene.camera, scene.sun_azimuth + 0.5, scene.sun_elevation)
    assert not prepare_stack(other, TINY, 3, tmp_path)[1].reused


def test_a_camera_that_looks_away_is_refused_with_a_reason() -> None:
    scene = small_scene()
    away = PinholeCamera((0.0, -500.0, 0.0), (0.0, -900.0, 0.0), math.radians(40.0), 16, 12)
    with pytest.raises(CameraError, match="sees no cloud"):
        prepare_stack(Scene(scene.grid, None, away, 0.0, 1.0), TINY)
