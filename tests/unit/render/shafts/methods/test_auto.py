from dataclasses import replace

import torch

from render.media import Uniform
from render.shafts.air import Air, Constituent
from render.shafts.methods import Auto, BruteForce
from render.shafts.truth import measure_error
from tests.support.shaft_scenes import FOG, small_scene, small_stage


def test_it_skips_what_the_scene_does_not_require() -> None:
    scene = small_scene()
    cases = {
        "nothing scatters": small_scene(air=Air((Constituent(Uniform(0.0, 5.0)),))),
        "nothing shines": replace(scene, sun=None, lights=()),
        "nothing casts any": small_scene(meshes=()),
        "closed form": small_scene(meshes=(), air=Air((FOG,)), lamps=False),
        "lamps: there are none": small_scene(lamps=False),
        "the sun: there is none": replace(scene, sun=None),
    }
    for words, case in cases.items():
        assert any(words in sentence for sentence in Auto().gather(small_stage(case)).skipped), words
    assert not Auto().gather(small_stage(scene)).skipped


def test_what_it_skips_does_not_show() -> None:
    for scene, error in (
        (small_scene(meshes=(), air=Air((FOG,)), lamps=False), 1e-4),
        (small_scene(meshes=()), 0.02),
        (small_scene(48, 32), 0.02),
    ):
        stage = small_stage(scene)
        truth = BruteForce(1024).gather(stage).in_scattering
        assert measure_error(Auto().gather(stage).in_scattering, truth).relative_rms < error
        assert measure_error(0.95 * truth, truth).relative_rms > error
    dark = Auto().gather(small_stage(replace(small_scene(), sun=None, lights=()))).in_scattering
    assert torch.equal(dark, torch.zeros_like(dark))
