import pytest

from render.errors import ParameterError
from render.shafts.methods import BruteForce, Chen2011, Engelhardt2010
from tests.support.shaft_scenes import relative_rms, small_scene, small_stage


def test_lit_stretches_beat_the_same_number_of_steps() -> None:
    stage = small_stage(small_scene(48, 32, lamps=False))
    truth = BruteForce(2048).gather(stage).in_scattering
    stretches, steps = (method.gather(stage).in_scattering for method in (Chen2011(16, 16), Engelhardt2010(16)))
    assert relative_rms(stretches, truth) < relative_rms(steps, truth)
    every = Chen2011(64, 64, None).gather(stage).in_scattering
    assert relative_rms(every, truth) < 1e-3


def test_no_nodes_are_refused() -> None:
    for nodes, steps in ((0, 1), (1, 0)):
        with pytest.raises(ParameterError):
            Chen2011(nodes, steps)
