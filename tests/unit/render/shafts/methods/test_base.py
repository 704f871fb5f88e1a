import pytest

from render.errors import ParameterError
from render.shafts.methods import METHODS, find_method
from render.shafts.methods.base import Gathered, check_steps
from render.shafts.truth import measure_error
from tests.support.shaft_scenes import small_scene, small_stage

STEPS = 256

MORE_STEPS = {"chen2011": 1024, "biri2006": 1024, "tan2020_froxels": 4096}
"""Of methods that agree with brute force only as far as its own steps are right: lit stretches are resolved to the texel there, and
froxels end at other places than steps."""


@pytest.mark.parametrize("name", METHODS)
def test_every_method_at_full_density_is_brute_force(name: str) -> None:
    stage = small_stage(small_scene(12, 8))
    steps = MORE_STEPS.get(name, STEPS)
    exact = METHODS["brute_force"].at_full_density(steps).gather(stage).in_scattering
    dense = METHODS[name].at_full_density(steps).gather(stage).in_scattering
    assert measure_error(dense, exact).relative_rms < 1e-4
    coarse = METHODS[name].at_full_density(steps // 16).gather(stage).in_scattering
    assert measure_error(coarse, exact).relative_rms > 1e-4


@pytest.mark.parametrize("name", METHODS)
def test_refinement_comes_nearer_to_the_truth(name: str) -> None:
    stage = small_stage(small_scene(32, 20))
    truth = METHODS["brute_force"].at_full_density(1024).gather(stage).in_scattering
    method = METHODS[name]
    errors = []
    for _ in range(3):
        errors.append(measure_error(method.gather(stage).in_scattering, truth).relative_rms)
        method = method.refined()
    assert errors[2] < 0.7 * errors[0]


def test_a_method_that_there_is_not() -> None:
    assert find_method("auto") is METHODS["auto"]
    with pytest.raises(ParameterError, match="there are auto, brute_force"):
        find_method("fast")
    with pytest.raises(ParameterError, match="at least one step"):
        check_steps(0)
    assert not Gathered(small_stage().background).modelled
