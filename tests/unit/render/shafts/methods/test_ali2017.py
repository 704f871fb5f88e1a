import pytest
import torch

from render.errors import ParameterError
from render.shafts.methods import Ali2017, BruteForce
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
