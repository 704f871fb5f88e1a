"""Does the error that `--tolerance` asks for come out, in scenes that nobody chose?"""

from dataclasses import replace

import pytest

from benchmarks.random_shaft_scenes import SCENES, draw_scene
from render.shafts.methods import METHODS
from render.shafts.stage import MapSettings, prepare_stage
from render.shafts.truth import choose_settings, compute_truth, measure_error

MAPS = MapSettings(1024, 128)
COARSE, WIDTH, HEIGHT = 192, 320, 180


@pytest.mark.slow
@pytest.mark.parametrize("name", ["auto", "interleaved"])
def test_settings_chosen_on_a_coarse_picture_keep_within_two_percent(name: str) -> None:
    kept = 0
    for number in range(SCENES):
        scene = draw_scene(number, 0, WIDTH, HEIGHT)[1]
        chosen = choose_settings(scene, METHODS[name], 0.02, MAPS, COARSE)
        stage = prepare_stage(scene, MAPS)
        error = measure_error(chosen.method.gather(stage).in_scattering, compute_truth(stage).in_scattering)
        kept += error.relative_rms <= 0.02
    assert kept >= 9


def test_shadows_matter_in_random_scenes() -> None:
    """Else any settings would do."""
    shares = []
    for number in range(SCENES):
        scene = draw_scene(number, 0, 48, 27)[1]
        assert scene.camera == draw_scene(number, 0, 48, 27)[1].camera
        assert scene.camera != draw_scene(number, 1, 48, 27)[1].camera
        stage = prepare_stage(scene, MapSettings(256, 64))
        truth = compute_truth(stage, 0.02).in_scattering
        without = prepare_stage(replace(scene, meshes=()), MapSettings(256, 64))
        bare = METHODS["brute_force"].at_full_density(32).gather(replace(stage, lighting=without.lighting))
        shares.append(measure_error(bare.in_scattering, truth).relative_rms)
    assert sum(share > 0.05 for share in shares) >= 8, shares


def test_coarse_pictures_err_more_than_large_ones() -> None:
    """The promise that settings chosen on a coarse picture rest upon: both are interpolated from lines."""
    errors = []
    for width in (192, 480):
        stage = prepare_stage(draw_scene(3, 0, width, width * 9 // 16)[1], MAPS)
        truth = compute_truth(stage).in_scattering
        errors.append(measure_error(METHODS["auto"].gather(stage).in_scattering, truth).relative_rms)
    assert errors[0] > errors[1] > 1e-3
