"""A search on a sample of the pixels that is settled on all of them."""

from dataclasses import replace

import pytest
import torch

from cloudfit.fit_problem import FitProblem
from cloudfit.fit_types import FitOptions
from cloudfit.optimisers.base import StopReason
from cloudfit.search import APART, RESCORED, SearchOutcome, _best_apart, search_parameters
from tests.support.small_scene import TINY, made_up_analysis, small_stack

OPTIONS = FitOptions(
    quality=TINY, optimiser="screened_evolution", evaluations=200, searches=1, search_pixels=60, seed=2
)


def problem() -> FitProblem:
    stack = small_stack()
    pixels = torch.rand(900, 3, generator=torch.Generator().manual_seed(1)) * 0.5 + 0.3
    sky = torch.full((36, 48, 3), 0.2)
    return FitProblem(made_up_analysis(pixels, sky), stack)


def test_a_sample_has_the_pixels_asked_for_and_the_same_space() -> None:
    whole = problem()
    count = len(whole.counted)
    assert whole.sampled(None) is whole.sampled(count) is whole.sampled(count // 2 + 1) is whole
    sample = whole.sampled(count // 3)
    assert count // 3 <= len(sample.counted) < count // 2
    assert sample is whole.sampled(count // 3)
    assert sample.space is whole.space
    assert sample.floor > whole.floor
    assert torch.equal(sample.sky, whole.sky[:, ::3])


def test_losses_of_a_sample_are_nearly_those_of_all_pixels() -> None:
    whole = problem()
    population = torch.rand(20, whole.space.dimension, generator=torch.Generator().manual_seed(2))
    all_pixels, some = whole.evaluate(population), whole.sampled(len(whole.counted) // 2).evaluate(population)
    assert float((all_pixels - some).abs().max()) < 2.0 * whole.sampled(len(whole.counted) // 2).floor
    assert not torch.equal(all_pixels, some)
    ranks = torch.stack([values.argsort().argsort().double() for values in (all_pixels, some)])
    assert float(torch.corrcoef(ranks)[0, 1]) > 0.95


def test_what_was_found_is_settled_on_all_pixels() -> None:
    whole = problem()
    stages: list[tuple[str, float]] = []
    outcome = search_parameters(whole, OPTIONS, lambda stage, share: stages.append((stage, share)))
    assert outcome.sampled is whole.sampled(60)
    assert outcome.coarse.evaluations == 200
    assert outcome.evaluations == 200 + outcome.final.evaluations
    assert outcome.final.best_loss == pytest.approx(float(whole.evaluate(outcome.final.best[None])[0]), rel=1e-6)
    rescored = whole.evaluate(outcome.coarse.best[None])
    assert outcome.final.best_loss <= float(rescored[0]) + 1e-9
    assert float(rescored[0]) != outcome.coarse.best_loss
    assert len(outcome.history) == outcome.coarse.iterations + outcome.final.iterations
    assert bool((outcome.history.diff() <= 0).all())
    assert not outcome.interrupted
    assert stages[-1][1] == pytest.approx(1.0)


def test_without_a_sample_the_optimiser_sees_all_pixels() -> None:
    whole = problem()
    outcome = search_parameters(whole, replace(OPTIONS, search_pixels=None, evaluations=60))
    assert outcome.sampled is whole
    assert outcome.final is outcome.coarse
    assert outcome.evaluations == 60
    assert torch.equal(outcome.history, outcome.coarse.history)


def test_the_same_seed_finds_the_same() -> None:
    first, second, other = (
        search_parameters(problem(), replace(OPTIONS, evaluations=60, seed=seed)) for seed in (1, 1, 2)
    )
    assert torch.equal(first.final.evaluated, second.final.evaluated)
    assert not torch.equal(first.coarse.evaluated, other.coarse.evaluated)


def test_an_interrupted_search_keeps_its_incumbent_on_all_pixels() -> None:
    whole = problem()

    def interrupt(stage: str, share: float) -> None:
        raise KeyboardInterrupt

    outcome: SearchOutcome = search_parameters(whole, OPTIONS, interrupt)
    assert outcome.interrupted
    assert outcome.final.stop_reason is StopReason.INTERRUPTED
    assert outcome.final.evaluations == 1
    assert torch.equal(outcome.final.best, outcome.coarse.best)
    assert outcome.final.best_loss == pytest.approx(float(whole.evaluate(outcome.coarse.best[None])[0]))


def test_points_that_are_scored_again_keep_a_distance() -> None:
    generator = torch.Generator().manual_seed(4)
    points = torch.rand(2000, 2, generator=generator)
    losses = (points - 0.5).square().sum(1)
    chosen = _best_apart(points, losses)
    assert int(chosen[0]) == int(losses.argmin())
    assert bool((losses[chosen].diff() >= 0).all())
    apart = (points[chosen][:, None] - points[chosen][None]).abs().amax(2) + torch.eye(len(chosen))
    assert float(apart.min()) >= APART
    assert 20 < len(chosen) <= RESCORED
    crowded = losses.argsort()[: len(chosen)]
    assert (
        float(((points[crowded][:, None] - points[crowded][None]).abs().amax(2) + torch.eye(len(crowded))).min())
        < APART
    )
