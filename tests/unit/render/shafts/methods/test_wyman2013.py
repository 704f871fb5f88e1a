from dataclasses import replace

import pytest
import torch

from render.camera import OrthographicCamera
from render.errors import ParameterError
from render.shafts.methods import BruteForce, Wyman2013
from render.shafts.scene_file import load_scene
from render.shafts.stage import MapSettings, prepare_stage
from render.shafts.voxel_shadows import VoxelCounts
from tests.support.shaft_scenes import relative_rms, small_scene, small_stage


def test_small_voxels_come_near_to_exact_shadows() -> None:
    stage = small_stage(small_scene(24, 16), MapSettings(exact=True))
    exact = BruteForce(64).gather(stage).in_scattering
    fine, coarse = (Wyman2013(64, VoxelCounts(size, size, size)).gather(stage).in_scattering for size in (768, 24))
    assert relative_rms(fine, exact) < 0.01
    assert relative_rms(coarse, exact) > 3.0 * relative_rms(fine, exact)


def test_no_ray_lies_outside_of_the_grid() -> None:
    """The outermost rays of a room, which rounding puts before the first voxel: under its ceiling they see no sun."""
    stage = prepare_stage(load_scene("window").resized(64, 36), MapSettings(1024))
    exact = BruteForce(96).gather(stage).in_scattering
    found = Wyman2013(96, VoxelCounts(512, 512, 512)).gather(stage).in_scattering
    assert float((found - exact).abs().max() / exact.max()) < 0.1
    assert relative_rms(found, exact) < 0.03


def test_without_an_eye_or_things_it_is_brute_force() -> None:
    camera = OrthographicCamera((0.0, -50.0, 9.0), (0.0, 0.0, 9.0), 30.0, 12, 8)
    for scene in (replace(small_scene(), camera=camera), small_scene(12, 8, meshes=())):
        stage = small_stage(scene)
        marched = Wyman2013(16).gather(stage)
        torch.testing.assert_close(marched.in_scattering, BruteForce(16).gather(stage).in_scattering)
        assert set(marched.seconds) == {"voxels", "marching"}


def test_refined_grids_have_smaller_voxels() -> None:
    assert Wyman2013(8, VoxelCounts(2, 3, 4)).refined() == Wyman2013(16, VoxelCounts(4, 6, 8))
    with pytest.raises(ParameterError):
        Wyman2013(0)
