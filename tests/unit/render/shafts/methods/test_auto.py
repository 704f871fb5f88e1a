from dataclasses import replace

import torch

from render.media import Uniform
from render.shafts.air import Air, Constituent
from render.shafts.methods import Auto, BruteForce, Froxels
from render.shafts.truth import measure_error
from tests.support.shaft_scenes import FOG, small_scene, small_stage
from tests.unit.render.shafts.test_fog_bank import FOG as BANK


def test_it_skips_what_the_scene_does_not_require() -> None:
    scene = small_scene()
    cases = {
        "nothing scatters": small_scene(air=Air((Constituent(Uniform(0.0, 5.0)),))),
        "nothing shines": replace(scene, sun=None, lights=()),
        "nothing casts any": small_scene(meshes=()),
        "closed form": small_scene(meshes=(), air=Air((FOG,)), lamps=False),
        "lamps: there are none": small_scene(lamps=False),
        "the sun: there is none": replace(scene, sun=None),
        "froxels: the glow": replace(scene, lights=2 * scene.lights),
    }
    for words, case in cases.items():
        assert any(words in sentence for sentence in Auto().gather(small_stage(case)).skipped), words
    assert not Auto().gather(small_stage(scene)).skipped


def test_a_bank_of_fog_is_no_closed_form() -> None:
    clear = small_scene(96, 64, meshes=(), air=Air((FOG,)), lamps=False)
    foggy = small_stage(replace(clear, air=replace(clear.air, constituents=(), banks=(BANK,))))
    gathered = Auto().gather(foggy)
    assert not any("closed form" in sentence for sentence in gathered.skipped)
    truth = BruteForce(512).gather(foggy).in_scattering
    assert measure_error(gathered.in_scattering, truth).relative_rms < 0.03
    assert measure_error(BruteForce(1).gather(foggy).in_scattering, truth).relative_rms > 0.2


def test_many_lamps_are_marched_because_froxels_err_more() -> None:
    scene = small_scene(64, 40)
    lamps = tuple(replace(scene.lights[0], position=(x, y, 4.0)) for x in (-12.0, -4.0, 6.0) for y in (-12.0, 2.0))
    stage = small_stage(replace(scene, sun=None, lights=lamps))
    truth = BruteForce(1024).gather(stage).in_scattering
    marched, cells = (measure_error(method.gather(stage).in_scattering, truth) for method in (Auto(), Froxels()))
    assert marched.relative_rms < 0.03
    assert cells.relative_rms > 3.0 * marched.relative_rms


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
