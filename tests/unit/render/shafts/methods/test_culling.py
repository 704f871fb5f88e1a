from dataclasses import replace

import torch

from render.camera import OrthographicCamera
from render.shafts.march import ShadowLooks, march
from render.shafts.methods.culling import gather_lit_parts, sun_map
from render.shafts.rays import uniform_edges
from render.shafts.stage import MapSettings
from tests.support.shaft_scenes import relative_rms, small_scene, small_stage


def test_lit_parts_give_the_light_of_fine_steps() -> None:
    stage = small_stage(small_scene(lamps=False))
    seen, sun = sun_map(stage, stage.lighting), stage.lighting.sun
    assert seen is not None
    assert sun is not None
    own = torch.arange(len(stage.rays))
    light = gather_lit_parts(stage.scene.air, sun, seen, stage.rays, own, 64)
    fine = march(
        stage.scene.air, stage.lighting, stage.rays, uniform_edges(stage.rays, 128), looks=ShadowLooks(8, 8)
    ).in_scattering
    assert relative_rms(light, fine) < 1e-3
    unshadowed = gather_lit_parts(stage.scene.air, sun, replace(seen, tops=seen.tops - 1e4), stage.rays, own, 64)
    assert relative_rms(unshadowed, fine) > 0.01
    assert gather_lit_parts(stage.scene.air, sun, seen, stage.rays[:0], own[:0], 4).shape == (0, 3)


def test_slices_need_a_map_and_one_eye() -> None:
    stage = small_stage()
    sun, lamp = stage.lighting.separate()
    assert sun_map(stage, sun) is not None
    assert sun_map(stage, lamp) is None
    assert (
        sun_map(small_stage(maps=MapSettings(exact=True)), small_stage(maps=MapSettings(exact=True)).lighting) is None
    )
    parallel = replace(small_scene(), camera=OrthographicCamera((0.0, -50.0, 9.0), (0.0, 0.0, 9.0), 30.0, 12, 8))
    assert sun_map(small_stage(parallel), small_stage(parallel).lighting) is None
