import pytest
import torch

from render.errors import ParameterError
from render.shafts.methods import METHODS, Ali2017, BruteForce
from render.shafts.methods.ali2017 import shift_pattern
from tests.support.shaft_scenes import relative_rms, small_scene, small_stage


@pytest.mark.parametrize("taps", [2, 4, 8, 16, 32])
def test_few_pixels_stand_for_all(taps: int) -> None:
    stage = small_stage(small_scene(64, 40))
    exact = BruteForce(48).gather(stage).in_scattering
    filled = Ali2017(48, 2, taps).gather(stage)
    assert relative_rms(filled.in_scattering, exact) < (0.12 if taps < 16 else 0.3)
    assert "one pixel in 4" in filled.modelled[0]


def test_pixels_that_nothing_reaches_are_marched() -> None:
    stage = small_stage(small_scene(64, 40))
    exact = BruteForce(48).gather(stage).in_scattering
    marched, guessed = (Ali2017(48, 4, 2, 0.01, march_unmatched=m).gather(stage).in_scattering for m in (True, False))
    assert relative_rms(marched, exact) < relative_rms(guessed, exact)


def test_the_filter_smooths_a_whole_frame() -> None:
    stage = small_stage()
    smooth = Ali2017(48, 1, 8).gather(stage).in_scattering
    assert not torch.equal(smooth, BruteForce(48).gather(stage).in_scattering)
    with pytest.raises(ParameterError, match="taps"):
        Ali2017(8, 2, 3).gather(stage)
    with pytest.raises(ParameterError):
        Ali2017(0)
    with pytest.raises(ParameterError, match="1, 2, 4"):
        Ali2017(pattern=3)


def test_every_shift_occurs_once_and_near_ones_are_apart() -> None:
    for edge in (1, 2, 4, 8):
        shifts = shift_pattern(edge)
        expected = (torch.arange(edge * edge) + 0.5) / (edge * edge)
        torch.testing.assert_close(shifts.flatten().sort().values, expected)
        if edge > 1:
            beside = (shifts - shifts.roll(1, 1)).abs()
            assert float(beside.min()) >= 0.24


def test_shifted_steps_cancel_the_errors_of_neighbours() -> None:
    stage = small_stage(small_scene(240, 150, lamps=False))
    truth = BruteForce(512).gather(stage).in_scattering
    same, shifted = (Ali2017(8, 2, 4, pattern=pattern).gather(stage) for pattern in (1, 4))
    assert relative_rms(shifted.in_scattering, truth) < 0.7 * relative_rms(same.in_scattering, truth)
    raw = Ali2017(8, 1, 1, pattern=4).gather(stage).in_scattering
    assert relative_rms(raw, truth) > relative_rms(shifted.in_scattering, truth), "it is the filter that takes the mean"
    assert "squares of 4" in shifted.modelled[0]


def test_refinement_ends_without_a_filter() -> None:
    method = METHODS["interleaved"].refined()
    assert (method.factor, method.taps, method.pattern) == (1, 4, 4)
    assert (method.refined().taps, method.refined().pattern) == (2, 1)
    assert METHODS["ali2017"].pattern == 1
