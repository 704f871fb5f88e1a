import math

import pytest

from render.camera import PinholeCamera
from render.errors import ParameterError, SceneError
from render.shafts.scene import ShaftScene

CAMERA = PinholeCamera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 1.0, 8, 6)


def test_a_scene_is_resized_with_its_camera() -> None:
    assert ShaftScene(CAMERA).resized(4, 3).camera.width == 4
    assert ShaftScene(CAMERA).air.empty


def test_numbers_without_meaning_are_refused() -> None:
    for reach in (0.0, math.inf, math.nan):
        with pytest.raises(SceneError, match="reach"):
            ShaftScene(CAMERA, reach=reach)
    with pytest.raises(ParameterError, match="ambient"):
        ShaftScene(CAMERA, ambient=(-1.0, 0.0, 0.0))
    with pytest.raises(ParameterError, match="sky"):
        ShaftScene(CAMERA, sky=(math.nan, 0.0, 0.0))
