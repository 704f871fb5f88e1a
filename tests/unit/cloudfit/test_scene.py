import math

import pytest
import torch

from cloudfit.scene import Scene
from tests.support.small_scene import small_scene


def test_the_sun_stands_where_its_angles_say() -> None:
    scene = small_scene()
    east = Scene(scene.grid, None, scene.camera, math.radians(90.0), 0.0)
    assert east.sun_direction.tolist() == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)
    above = Scene(scene.grid, None, scene.camera, math.radians(90.0), math.radians(90.0))
    assert above.sun_direction.tolist() == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
    assert float(torch.linalg.vector_norm(scene.sun_direction)) == pytest.approx(1.0, abs=1e-6)
