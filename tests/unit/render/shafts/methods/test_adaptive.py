import math
from dataclasses import replace

import pytest

from render.errors import ParameterError
from render.shafts.march import ShadowLooks
from render.shafts.methods import Adaptive, BruteForce
from tests.support.shaft_scenes import relative_rms, small_scene, small_stage

STAGE = small_stage(small_scene(64, 40))
TRUTH = BruteForce(1024).gather(STAGE).in_scattering


def error_of(method: Adaptive) -> float:
    return relative_rms(method.gather(STAGE).in_scattering, TRUTH)


def test_the_usual_settings_meet_two_percent() -> None:
    assert error_of(Adaptive()) < 0.02


@pytest.mark.parametrize(
    "switched_off",
    [
        {"looks": ShadowLooks()},
        {"lines": None, "contrast": math.inf, "factor": 6},
        {"steps": 3, "looks": ShadowLooks(2)},
        {"lamp_steps": None, "steps": 8},
    ],
)
def test_each_part_earns_its_place(switched_off: dict[str, object]) -> None:
    assert error_of(replace(Adaptive(), **switched_off)) > 1.2 * error_of(Adaptive())


def test_blocks_and_two_levels_of_steps_work_too() -> None:
    assert error_of(replace(Adaptive(), lines=None)) < 0.02
    assert error_of(replace(Adaptive(), near_share=0.5, steps=32)) < 0.03
    schedule = Adaptive(steps=10, near_share=0.4, near_part=0.25).schedule(200.0)
    assert (schedule.near_steps, schedule.far_steps, schedule.near_distance) == (4, 6, 50.0)


def test_the_report_says_what_was_marched() -> None:
    gathered = Adaptive(factor=4).gather(small_stage(small_scene(240, 160)))
    assert gathered.modelled[0] == "16 steps of 7 looks for shadows, 10 steps of 4 looks for half a turn at a lamp"
    assert [sentence.partition(":")[0] for sentence in gathered.modelled[1:]] == ["the sun", "one lamp"]
    assert {"epipolar lines", "marching", "interpolation", "filling", "refinement"} == set(gathered.seconds)


def test_numbers_without_meaning_are_refused() -> None:
    for wrong in (
        {"steps": 0},
        {"factor": 0},
        {"near_share": 1.0},
        {"near_part": 0.0},
        {"contrast": 0.0},
        {"spent": 1.0},
        {"lamp_steps": 1},
    ):
        with pytest.raises(ParameterError):
            replace(Adaptive(), **wrong)
