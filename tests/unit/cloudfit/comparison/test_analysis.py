import math

import pytest

from cloudfit.comparison.analysis import Analysis
from cloudfit.optimisers.base import PENALTY
from render.errors import ParameterError
from tests.support.comparison import facts, make_run

# Problem p, best loss 1: "a" gets there after 10 evaluations and 1 s in one of two runs, "b" stays at twice the loss.
GOOD = ((1, 0.1, 2.0), (10, 1.0, 1.0))
BAD = ((1, 0.2, 2.0),)
RUNS = [
    make_run("a", seed=0, steps=GOOD, seconds=4.0),
    make_run("a", seed=1, steps=BAD, seconds=4.0),
    make_run("b", seed=0, steps=BAD, seconds=8.0),
    make_run("b", seed=1, steps=BAD, seconds=8.0),
]


def analyse(budget_seconds: float | None = None) -> Analysis:
    return Analysis.of_runs(RUNS, [facts()], ["b", "a", "unused"], 100, budget_seconds)


def test_the_figures_of_merit_of_a_cell_by_hand() -> None:
    analysis = analyse()
    assert analysis.methods == ("b", "a")
    merit = analysis.merit("a")
    assert (merit.runs, merit.failed) == (2, 0)
    assert merit.loss == (1.25, 1.5, 1.75)
    assert merit.excess == (0.25, 0.5, 0.75)
    assert merit.success_rate == 0.5
    assert merit.ert_evaluations == 10 + 100
    assert merit.ert_seconds == 1.0 + 4.0
    # Score 1/4 for excess 1, 1 for excess 0; a decade of evaluations each in the good run.
    assert merit.aocc_evaluations == pytest.approx(((0.25 + 1.0) / 2 + 0.25) / 2)
    assert merit.evaluations == 100
    assert merit.objective_seconds == 3.0
    assert merit.overhead_seconds == 1.0
    other = analysis.merit("b")
    assert other.success_rate == 0.0
    assert other.ert_evaluations == math.inf
    assert other.aocc_evaluations == pytest.approx(0.25)


def test_seconds_are_compared_up_to_where_the_fastest_method_ends() -> None:
    assert analyse().problems["p"].seconds_horizon == 4.0
    assert analyse(budget_seconds=6.0).problems["p"].seconds_horizon == 6.0
    # Two decades up to 4 s: the good run knows nothing until 0.1 s, excess 1 until 1 s, 0 until 4 s.
    area = analyse().problems["p"].areas("a", by_seconds=True)[0]
    expected = (0.25 * math.log(1.0 / 0.1) + 1.0 * math.log(4.0)) / math.log(100.0)
    assert area == pytest.approx(expected)


def test_methods_are_ranked_and_contrasted_by_their_area() -> None:
    analysis = analyse()
    assert analysis.ranking() == ["a", "b"]
    (contrast,) = analysis.contrasts(by_seconds=False)
    assert (contrast.first, contrast.second) == ("b", "a")
    assert contrast.difference == pytest.approx(0.25 - 0.4375)
    assert contrast.p_value == 1.0, "one problem proves nothing"


def test_pooled_times_and_extremes() -> None:
    analysis = analyse()
    times = analysis.pooled_runtimes("a", by_seconds=False)
    assert len(times) == 2 * 41
    assert sorted(set(times.tolist())) == [1.0, 10.0, math.inf]
    # The first losses are all 2: converged means a loss of at most 1.01; two parameters.
    assert sorted(analysis.pooled_gradients("a").tolist()) == [10 / 3, math.inf]
    blind = [make_run("c", seed=n, steps=((1, 0.0, PENALTY), (2, 0.0, 2.0))) for n in range(9)]
    more = Analysis.of_runs([*RUNS, *blind], [facts()], ["a", "b", "c"], 100, None)
    assert more.pooled_gradients("c").tolist() == [math.inf] * 9, "a penalty is no loss to start from"
    extremes = analysis.extreme_runs("a")
    assert extremes is not None
    assert [run.seed for run in extremes] == [0, 1]


def test_a_run_that_found_nothing_is_worse_than_all_others() -> None:
    runs = [*RUNS, make_run("c", seed=0, steps=(), failed=True, evaluations=0), make_run("c", seed=1, steps=GOOD)]
    analysis = Analysis.of_runs(runs, [facts()], ["a", "c"], 100, None)
    merit = analysis.merit("c")
    assert (merit.failed, merit.success_rate) == (1, 0.5)
    assert merit.loss == (math.inf, math.inf, math.inf)
    assert merit.aocc_evaluations == pytest.approx((0.25 + 1.0) / 4)
    only = Analysis.of_runs(runs[4:5] + RUNS, [facts()], ["a", "c"], 100, None)
    assert only.methods == ("a",), "a method that evaluated nothing has no rank"


def test_a_comparison_of_nothing_is_refused() -> None:
    with pytest.raises(ParameterError, match="no run"):
        Analysis.of_runs([], [facts()], ["a"], 100, None)


def test_problems_that_some_methods_lack_are_left_out_of_contrasts() -> None:
    runs = [*RUNS, make_run("a", problem="q", steps=GOOD)]
    analysis = Analysis.of_runs(runs, [facts(), facts("q")], ["a", "b"], 100, None)
    assert analysis.contrasts(False)[0].p_value == 1.0
    assert len(analysis.cells()) == 3
