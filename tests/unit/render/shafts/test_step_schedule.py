import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from render.errors import ParameterError
from render.random_streams import child_generator
from render.shafts.step_schedule import Steps, StepSchedule, count_needed_steps


def tile(schedule: StepSchedule, start: float, end: float) -> Steps:
    return schedule.tile(torch.tensor([start], dtype=torch.float64), torch.tensor([end], dtype=torch.float64))


def test_far_steps_follow_the_rule() -> None:
    """Four far steps over 100 m after 20 m in two near steps: 10, 20, 30, 40 m."""
    steps = tile(StepSchedule(2, 4, 20.0, smooth_transition=False), 0.0, 120.0)
    assert steps.lengths[0].tolist() == pytest.approx([10.0, 10.0, 10.0, 20.0, 30.0, 40.0])
    assert steps.samples[0].tolist() == pytest.approx([5.0, 15.0, 25.0, 40.0, 65.0, 100.0])
    rule = [100.0 * 2 * (i + 1) / (4 * 5) for i in range(4)]
    assert steps.lengths[0, 2:].tolist() == pytest.approx(rule)


def test_the_rule_without_the_one_does_not_tile() -> None:
    for count in (1, 4, 30):
        assert sum(2 * (i + 1) / (count * (count + 1)) for i in range(count)) == pytest.approx(1.0)
        assert 1.0 - sum(2 * i / (count * (count + 1)) for i in range(count)) == pytest.approx(2 / (count + 1))


def test_the_smooth_transition_grows_from_the_near_step() -> None:
    lengths = tile(StepSchedule(4, 5, 20.0), 0.0, 120.0).lengths[0]
    assert lengths[:4].tolist() == pytest.approx([5.0] * 4)
    growth = lengths[3:].diff()
    assert growth.tolist() == pytest.approx([5.0] * 5)  # (100 - 5 * 5) * 2 / 30
    abrupt = tile(StepSchedule(4, 5, 20.0, smooth_transition=False), 0.0, 120.0).lengths[0]
    assert abrupt[4].item() != pytest.approx(lengths[4].item(), rel=0.1)


def test_a_far_part_too_short_for_the_near_step_has_equal_steps() -> None:
    lengths = tile(StepSchedule(2, 5, 20.0), 0.0, 25.0).lengths[0]
    assert lengths[2:].tolist() == pytest.approx([1.0] * 5)


@pytest.mark.parametrize("smooth", [True, False])
@given(st.integers(0, 2**32), st.integers(1, 40), st.integers(1, 40), st.floats(1e-3, 1e5))
@settings(max_examples=40, deadline=None)
def test_steps_tile_every_stretch(smooth: bool, seed: int, near: int, far: int, border: float) -> None:
    start, end = (torch.rand(2, 50, generator=child_generator(seed)) * 3.0 * border).double().sort(0).values
    start[:10] = 0.0
    end[5:15] = start[5:15]
    steps = StepSchedule(near, far, border, smooth).tile(start, end)
    assert torch.equal(steps.edges[:, 0], start)
    assert torch.equal(steps.edges[:, -1], end)
    assert bool((steps.lengths >= -1e-12 * border).all())
    assert torch.allclose(steps.lengths.sum(1), end - start, rtol=1e-12, atol=0.0)
    assert steps.lengths.shape == (50, near + far)


def test_integrals_converge_to_the_closed_form() -> None:
    """Light scattered along 1 km of uniform fog: (1 - exp(-tau)) / sigma."""
    sigma, exact = 0.01, (1.0 - math.exp(-10.0)) / 0.01
    errors = []
    for count in (20, 40, 80):
        steps = tile(StepSchedule.from_ratio(count, 2.0, 1.0, 200.0), 0.0, 1000.0)
        found = float((steps.lengths * torch.exp(-sigma * steps.samples)).sum())
        errors.append(abs(found / exact - 1.0))
    assert errors[0] > 3.0 * errors[1] > 9.0 * errors[2]
    equal = tile(StepSchedule.uniform(80), 0.0, 1000.0)
    assert abs(float((equal.lengths * torch.exp(-sigma * equal.samples)).sum()) / exact - 1.0) > 2.0 * errors[2]


def test_steps_are_shared_by_ratio() -> None:
    assert StepSchedule.from_ratio(60, 3.0, 1.0, 100.0) == StepSchedule(45, 15, 100.0)
    assert StepSchedule.from_ratio(60, 1.0, 3.0, 100.0) == StepSchedule(15, 45, 100.0)
    assert StepSchedule.from_ratio(2, 1e9, 1.0, 100.0).far_steps == 1
    assert StepSchedule.uniform(7).steps == 7


def test_schedules_that_cannot_be_are_refused() -> None:
    with pytest.raises(ParameterError, match="near steps"):
        StepSchedule(0, 4, 20.0)
    with pytest.raises(ParameterError, match="positive length"):
        StepSchedule(4, 4, math.nan)
    with pytest.raises(ParameterError, match="near to infinity"):
        StepSchedule(4, 0, 20.0)
    with pytest.raises(ParameterError, match="at least 2"):
        StepSchedule.from_ratio(1, 1.0, 1.0, 20.0)
    with pytest.raises(ParameterError, match="ratios"):
        StepSchedule.from_ratio(8, 0.0, 1.0, 20.0)
    for start, end in ((1.0, 0.0), (0.0, math.inf), (-1.0, 1.0), (0.0, math.nan)):
        with pytest.raises(ParameterError, match="stretches"):
            tile(StepSchedule.uniform(4), start, end)


def test_steps_behind_spent_light_are_not_needed() -> None:
    depth = torch.tensor([[1.0, 2.0, 3.0, 4.0], [0.5, 0.6, 2.5, 2.6]])
    assert count_needed_steps(depth, 0.0) == 4
    assert count_needed_steps(depth, math.exp(-2.2)) == 3
    assert count_needed_steps(depth[:1], math.exp(-2.2)) == 3
    assert count_needed_steps(depth[:1], math.exp(-1.9)) == 2
    assert count_needed_steps(depth, 1.0) == 0
    with pytest.raises(ParameterError, match="transmittance"):
        count_needed_steps(depth, 1.5)
