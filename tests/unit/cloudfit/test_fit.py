from dataclasses import replace

import pytest
import torch

from cloudfit.fit import describe_doubts, fit_photograph
from cloudfit.fit_problem import FitProblem
from cloudfit.fit_types import AIR_DEPTHS, FitOptions
from render.errors import ParameterError
from tests.support.small_scene import TINY, small_scene, small_stack
from tests.unit.cloudfit.test_fit_problem import guess_space_truth, problem_in_place, problem_with_known_answer

OPTIONS = FitOptions(quality=TINY, evaluations=400, searches=2, candidates=2, seed=5)


def test_a_photograph_of_the_same_cloud_is_matched_and_the_answers_are_ranked() -> None:
    problem = problem_with_known_answer()
    stages: list[str] = []
    fit = fit_photograph(
        problem.analysis, small_scene(), small_stack(), OPTIONS, lambda stage, share: stages.append(stage)
    )
    random = problem.evaluate(torch.rand(20, 5, generator=torch.Generator().manual_seed(0)))
    # One of the random points may be lucky; no more than that may be.
    assert fit.candidates[0].promised_loss < min(float(random.min()), 0.25 * float(random.median()))
    assert [c.loss for c in fit.candidates] == sorted(c.loss for c in fit.candidates)
    assert fit.evaluations <= OPTIONS.evaluations + 20
    assert list(fit.history) == sorted(fit.history, reverse=True)
    assert not fit.interrupted
    assert any(stage.startswith("search") for stage in stages)
    assert "pictures" in stages
    best = fit.candidates[0]
    assert best.picture.rgb.shape == (36, 48, 3)
    assert best.histogram.shape == fit.histogram.shape == (3, 256)
    assert 0.0 < best.floor < 2.0


@pytest.mark.parametrize("loss", ["correlation", "squared_difference", "sorted_wasserstein"])
def test_any_loss_ranks_the_answers_in_its_own_units(loss: str) -> None:
    problem = problem_in_place(loss)
    options = replace(OPTIONS, optimiser="genetic", evaluations=120, searches=1, candidates=2, loss=loss)
    fit = fit_photograph(problem.analysis, small_scene(), small_stack(), options)
    best = fit.candidates[0]
    random = problem(torch.rand(40, 5, generator=torch.Generator().manual_seed(0)))
    assert [c.loss for c in fit.candidates] == sorted(c.loss for c in fit.candidates)
    assert min(c.promised_loss for c in fit.candidates) == fit.history[-1] < 0.5 * float(random.median())
    assert 0.0 < best.loss < float(random.median())
    assert (best.floor == 0.0) is (loss == "squared_difference")


def test_what_the_photograph_determines_is_reported() -> None:
    problem = problem_with_known_answer()
    # How many answers come near the best is chance after 400 evaluations: 4 to 113 with six seeds.
    options = replace(OPTIONS, candidates=1, evaluations=600)
    fit = fit_photograph(problem.analysis, small_scene(), small_stack(), options)
    assert fit.determination is not None
    assert [spread.name for spread in fit.determination.parameters] == list(problem.space.names)
    assert fit.determination.answers > 10
    best = fit.candidates[0].parameters
    for spread in fit.determination.parameters:
        assert (1 - 1e-5) * spread.lowest <= best[spread.name] <= (1 + 1e-5) * spread.highest
    assert fit.determination.excess <= max(problem.floor, 1.1 * fit.history[-1]) - fit.history[-1] + 1e-12
    assert "comparing answers" in fit.seconds


def test_the_same_seed_gives_the_same_fit_and_another_seed_another() -> None:
    problem = problem_with_known_answer()
    few = FitOptions(quality=TINY, evaluations=60, searches=1, candidates=1, seed=5)
    first, again, other = (
        fit_photograph(problem.analysis, small_scene(), small_stack(), options)
        for options in (few, few, FitOptions(quality=TINY, evaluations=60, searches=1, candidates=1, seed=6))
    )
    assert first.candidates[0].parameters == again.candidates[0].parameters
    assert first.candidates[0].loss == again.candidates[0].loss
    assert first.candidates[0].parameters != other.candidates[0].parameters


def test_the_air_of_the_search_and_of_the_picture_is_refined_unless_the_paper_s_is_asked_for() -> None:
    problem = problem_with_known_answer((0.1, 0.2, 0.5))
    options = replace(OPTIONS, optimiser="genetic", evaluations=60, searches=1, candidates=1)
    fine, coarse = (
        fit_photograph(problem.analysis, small_scene(), small_stack(), replace(options, air_refinements=number))
        for number in (2, 0)
    )
    assert all(min(abs(depth - step) for step in AIR_DEPTHS) < 1e-6 for depth in coarse.candidates[0].air_depth)
    assert any(min(abs(depth - step) for step in AIR_DEPTHS) > 0.03 for depth in fine.candidates[0].air_depth)
    # The same points: those of the first generation.
    assert fine.history[0] < coarse.history[0]


def test_an_interruption_leaves_the_best_answer_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_with_known_answer()
    calls = 0
    evaluate = FitProblem.evaluate

    def interrupted(self: FitProblem, population: torch.Tensor) -> torch.Tensor:
        nonlocal calls
        calls += 1
        if calls == 3:
            raise KeyboardInterrupt
        return evaluate(self, population)

    monkeypatch.setattr(FitProblem, "evaluate", interrupted)
    options = replace(OPTIONS, optimiser="genetic")
    fit = fit_photograph(problem.analysis, small_scene(), small_stack(), options)
    assert fit.interrupted
    assert len(fit.candidates) == 1
    assert fit.determination is None
    assert fit.evaluations == 39


def test_what_a_user_should_not_trust_is_said() -> None:
    problem = problem_with_known_answer()
    best = fit_photograph(problem.analysis, small_scene(), small_stack(), OPTIONS).candidates[0]
    inside = {
        **best.parameters,
        "sunlight_intensity": 0.1 * problem.space.parameters[0].upper,
        "albedo": 0.5,
        "ambient": 0.5,
    }
    inside |= {"asymmetry": 0.4, "extinction": 0.1}
    quiet = replace(best, parameters=inside, promised_loss=best.loss)
    assert describe_doubts(problem, quiet) == []
    assert (
        "albedo sits on the upper bound"
        in describe_doubts(problem, replace(quiet, parameters={**inside, "albedo": 1.0}))[0]
    )
    assert "the stack promised" in describe_doubts(problem, replace(quiet, promised_loss=best.loss + 0.2))[0]


def test_an_unknown_optimiser_is_refused() -> None:
    with pytest.raises(ParameterError, match="no optimiser is called 'magic'"):
        fit_photograph(
            problem_with_known_answer().analysis,
            small_scene(),
            small_stack(),
            FitOptions(quality=TINY, optimiser="magic"),
        )


def test_the_truth_of_the_tests_lies_in_the_cube() -> None:
    truth = guess_space_truth(problem_with_known_answer())
    assert bool(((truth >= 0.0) & (truth <= 1.0)).all())
