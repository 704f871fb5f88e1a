import math

import numpy as np
import pytest

from cloudfit.comparison.performance import (
    HIGHEST_EXCESS,
    LOWEST_EXCESS,
    anytime_area,
    distribution,
    excess,
    expected_running_time,
    loss_of_excess,
    profile_target,
    quartiles,
    runtimes,
    score,
    simplex_gradients,
    target_excesses,
)
from render.errors import ParameterError
from tests.support.comparison import make_run, trace


def test_targets_are_log_spaced_from_eleven_times_the_best_loss_to_a_thousandth_above_it() -> None:
    targets = target_excesses()
    assert len(targets) == 41
    assert targets[0] == pytest.approx(10.0)
    assert targets[10] == pytest.approx(1.0)
    assert targets[-1] == pytest.approx(1e-3)


def test_excess_is_relative_to_the_best_loss_or_the_floor() -> None:
    assert excess(0.303, 0.3, 0.1) == pytest.approx(0.01)
    assert excess(0.01, 0.0, 0.1) == pytest.approx(0.1)
    assert excess(0.29, 0.3, 0.1) == 0.0
    assert excess(math.inf, 0.3, 0.1) == math.inf
    assert loss_of_excess(0.01, 0.3, 0.1) == pytest.approx(0.303)
    with pytest.raises(ParameterError, match="positive"):
        excess(1.0, 0.0, 0.0)


def test_the_score_is_linear_in_the_logarithm() -> None:
    values = np.array([math.inf, 100.0, 10.0, 1.0, 0.1, 1e-3, 0.0])
    assert score(values) == pytest.approx([0.0, 0.0, 0.0, 0.25, 0.5, 1.0, 1.0])


def test_the_anytime_area_of_a_curve_that_can_be_drawn_by_hand() -> None:
    # Best loss 1: excess 1 (score 1/4) from evaluation 1, 0.1 (1/2) from 10, 0 (1) from 100 to 1000: a decade each.
    steps = trace((1, 0.1, 2.0), (10, 0.2, 1.1), (100, 0.3, 1.0))
    assert anytime_area(steps, steps.evaluation, 1.0, 1000.0, 1.0, 0.1) == pytest.approx((0.25 + 0.5 + 1.0) / 3)
    assert anytime_area(steps, steps.evaluation, 1.0, 100.0, 1.0, 0.1) == pytest.approx((0.25 + 0.5) / 2)
    # In seconds nothing is known during the first decade.
    late = trace((1, 1.0, 2.0))
    assert anytime_area(late, late.seconds, 0.1, 10.0, 1.0, 0.1) == pytest.approx(0.25 / 2)
    assert anytime_area(trace(), np.empty(0), 1.0, 10.0, 1.0, 0.1) == 0.0
    with pytest.raises(ParameterError, match="begin"):
        anytime_area(steps, steps.evaluation, 1.0, 1.0, 1.0, 0.1)


def test_the_anytime_area_is_the_area_under_the_runtime_distribution_over_many_targets() -> None:
    steps = trace((1, 0.0, 5.0), (7, 0.0, 1.9), (60, 0.0, 1.02))
    targets = loss_of_excess(np.geomspace(HIGHEST_EXCESS, LOWEST_EXCESS, 4001), 1.0, 0.1)
    times = np.array([steps.evaluations_until(float(target)) for target in targets])
    grid = np.geomspace(1.0, 500.0, 20001)
    under = float(distribution(times, grid).mean())
    assert anytime_area(steps, steps.evaluation, 1.0, 500.0, 1.0, 0.1) == pytest.approx(under, abs=1e-3)


def test_runtimes_are_the_first_times_at_which_targets_are_reached() -> None:
    runs = [make_run(steps=((1, 0.5, 2.0), (20, 3.0, 1.0))), make_run(steps=((1, 0.5, 2.0),))]
    table = runtimes(runs, 1.0, 0.1, by_seconds=False)
    assert table.shape == (2, 41)
    assert table[0, 10] == 1  # excess 1, a loss of 2
    assert table[0, 11] == 20
    assert table[1, 11] == math.inf
    assert runtimes(runs, 1.0, 0.1, by_seconds=True)[0, 40] == 3.0


def test_a_distribution_counts_what_was_never_reached() -> None:
    times = np.array([[1.0, 10.0], [math.inf, 10.0]])
    assert distribution(times, np.array([0.5, 1.0, 9.9, 10.0, 1e9])).tolist() == [0.0, 0.25, 0.25, 0.75, 0.75]


def test_data_profiles_ask_for_a_share_of_the_possible_reduction() -> None:
    assert profile_target(np.array([1.0, 2.0, 9.0]), best=1.0, tolerance=0.1) == pytest.approx(1.1)
    assert profile_target(np.array([0.5]), best=1.0) == 1.0
    assert simplex_gradients(np.array([12.0, math.inf]), dimension=5).tolist() == [2.0, math.inf]


def test_the_expected_running_time_charges_failures_to_the_successes() -> None:
    assert expected_running_time(np.array([10.0, 100.0, 30.0]), [True, False, True]) == 70.0
    assert expected_running_time(np.array([100.0]), [False]) == math.inf


def test_quartiles_are_interpolated() -> None:
    assert quartiles([4.0, 1.0, 3.0, 2.0]) == (1.75, 2.5, 3.25)
