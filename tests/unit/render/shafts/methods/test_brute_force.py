import pytest

from render.errors import ParameterError
from render.shafts.methods import BruteForce
from render.shafts.stage import MapSettings, relight
from tests.support.shaft_scenes import relative_rms, small_stage


def test_maps_come_near_to_exact_shadows() -> None:
    stage = small_stage(maps=MapSettings(512, 128))
    mapped = BruteForce(64).gather(stage).in_scattering
    exact = BruteForce(64).gather(relight(stage, MapSettings(exact=True))).in_scattering
    coarse = BruteForce(64).gather(relight(stage, MapSettings(8, 4))).in_scattering
    assert relative_rms(mapped, exact) < 0.01
    assert relative_rms(coarse, exact) > 3.0 * relative_rms(mapped, exact)


def test_no_steps_are_refused() -> None:
    with pytest.raises(ParameterError):
        BruteForce(0)
    assert BruteForce(3).refined() == BruteForce(6)
