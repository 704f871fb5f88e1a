import pytest
import torch

import render.shafts.truth as truth_module
from render.errors import ParameterError
from render.shafts.air import Air
from render.shafts.methods import Adaptive, BruteForce
from render.shafts.stage import Stage
from render.shafts.truth import choose_settings, compute_truth, measure_error
from tests.support.shaft_scenes import SMALL_MAPS, small_scene, small_stage


def test_errors_are_relative_to_the_truth() -> None:
    truth = torch.tensor([[1.0, 2.0, 2.0]])
    error = measure_error(truth + torch.tensor([[0.0, 0.0, 0.3]]), truth)
    assert error.relative_rms == pytest.approx(0.1)
    assert error.largest == pytest.approx(0.15)
    assert measure_error(truth, truth).largest == 0.0
    black = torch.zeros(1, 3)
    assert measure_error(black, black).relative_rms == 0.0
    assert measure_error(truth, black).relative_rms == float("inf")


def test_the_truth_is_converged() -> None:
    stage = small_stage()
    truth = compute_truth(stage, 1e-3)
    assert truth.change < 1e-3
    finer = BruteForce(4096).gather(stage).in_scattering
    assert measure_error(truth.in_scattering, finer).relative_rms < 2e-3
    assert measure_error(BruteForce(8).gather(stage).in_scattering, finer).relative_rms > 1e-2


def test_rays_that_have_settled_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    stage, marched = small_stage(), []
    whole = truth_module._march_everything

    def counting(some: Stage, steps: int) -> torch.Tensor:
        marched.append((len(some.rays), steps))
        return whole(some, steps)

    monkeypatch.setattr(truth_module, "_march_everything", counting)
    found = compute_truth(stage, 1e-4)
    assert marched[:3] == [(len(stage.rays), steps) for steps in (16, 32, 64)]
    assert marched[-1][0] < len(stage.rays)
    monkeypatch.setattr(truth_module, "SETTLED", 0.0)
    full = compute_truth(stage, 1e-4)
    assert measure_error(found.in_scattering, full.in_scattering).relative_rms < 1e-4
    monkeypatch.setattr(truth_module, "SETTLED", 100.0)
    hasty = compute_truth(stage, 1e-2)
    assert measure_error(hasty.in_scattering, full.in_scattering).relative_rms > 1e-4


def test_settings_keep_within_the_tolerance() -> None:
    scene = small_scene(48, 32)
    loose, tight = (choose_settings(scene, BruteForce(4), tolerance, SMALL_MAPS, 24) for tolerance in (0.2, 0.02))
    assert loose.error.relative_rms <= 0.1
    assert tight.error.relative_rms <= 0.01
    assert tight.refinements > loose.refinements
    assert choose_settings(scene, Adaptive(), 0.05, SMALL_MAPS, 24).error.relative_rms <= 0.025
    with pytest.raises(ParameterError, match="positive tolerance"):
        choose_settings(scene, BruteForce(), 0.0)


def test_nothing_to_see_is_converged_at_once() -> None:
    truth = compute_truth(small_stage(small_scene(air=Air())), 1e-3)
    assert truth.change == 0.0
