from dataclasses import replace

import pytest
import torch
from torch import Tensor

from cloudfit.fit_problem import FitProblem, brightest_radiance, resize_image, search_haze
from cloudfit.fit_types import AIR_DEPTHS, AIR_REFINEMENTS
from cloudfit.losses import LOSSES, l1_floor
from render.cloud_image import blend_air
from render.scattering_stack import ScatteringStack
from tests.support.small_scene import made_up_analysis, small_stack

SKY = torch.tensor([0.1, 0.25, 0.6])
TRUTH = torch.tensor([[0.70, 0.4, 0.7, 0.95, 0.2]])


def sky_image() -> Tensor:
    tables = small_stack().tables
    return SKY.expand(2 * tables.height, 2 * tables.width, 3).clone()


def problem_with_known_answer(air: tuple[float, float, float] = (0.0, 0.3, 0.6)) -> FitProblem:
    """The photograph is the stack's own image of TRUTH, seen through air."""
    guess = FitProblem(made_up_analysis(torch.full((50, 3), 0.8), sky_image()), small_stack())
    cloud = guess.compose(guess.space.to_physical(TRUTH))
    image = blend_air(cloud, guess.sky, torch.tensor([air]))[0].T
    return FitProblem(made_up_analysis(image, sky_image()), small_stack())


def test_the_true_parameters_have_no_loss_and_others_do() -> None:
    problem = problem_with_known_answer()
    truth = guess_space_truth(problem)
    others = truth.repeat(5, 1)
    others[range(5), range(5)] = (others.diagonal() * 0.5).clamp(min=0.05)
    losses = problem.evaluate(torch.cat([truth, others]))
    assert float(losses[0]) < 0.02
    assert bool((losses[1:] > 5.0 * losses[0] + 0.05).all())


def guess_space_truth(problem: FitProblem) -> Tensor:
    """TRUTH in the unit cube of this problem, whose sunlight range follows the photograph."""
    guess = FitProblem(made_up_analysis(torch.full((50, 3), 0.8), sky_image()), small_stack())
    return problem.space.to_unit(guess.space.to_physical(TRUTH))


def true_cloud(problem: FitProblem) -> Tensor:
    """Radiance of TRUTH without air."""
    return problem.compose(problem.space.to_physical(guess_space_truth(problem)))


@pytest.mark.parametrize("refinements", [0, AIR_REFINEMENTS])
def test_the_search_of_the_air_finds_the_air_of_each_channel(refinements: int) -> None:
    air = (AIR_DEPTHS[0], AIR_DEPTHS[1], AIR_DEPTHS[2])
    problem = problem_with_known_answer(air)
    found = search_haze(true_cloud(problem), problem.sky, problem.target, "srgb", refinements)
    assert found.air_depth[0].tolist() == pytest.approx(air)
    assert float(found.loss.max()) < 0.02
    swapped = search_haze(true_cloud(problem), problem.sky, problem.target.flip(0), "srgb", refinements)
    assert float(swapped.loss.max()) > 0.3


def test_refinements_find_air_between_the_steps_of_the_paper() -> None:
    # A ninth and a third of a step from one of the 11, and four ninths above no air at all.
    air = (0.3 + 0.1 / 3, 0.7, 0.1 + 0.1 / 3)
    problem = problem_with_known_answer(air)
    coarse, once, twice = (
        search_haze(true_cloud(problem), problem.sky, problem.target, "srgb", number) for number in range(3)
    )
    assert coarse.air_depth[0].tolist() == pytest.approx([0.3, 0.6, 0.0])
    assert once.air_depth[0].tolist() == pytest.approx([0.3, 0.7, 0.1])
    assert twice.air_depth[0].tolist() == pytest.approx(air)
    assert float(coarse.loss.min()) > 0.2
    assert float(twice.loss.max()) < 0.02
    histograms = torch.stack([coarse.histogram, once.histogram, twice.histogram])
    losses = torch.stack([coarse.loss, once.loss, twice.loss])
    assert torch.equal(LOSSES["l1"](histograms, problem.target), losses)
    assert bool((losses.diff(dim=0) <= 0.0).all())


def test_refined_air_stays_between_none_and_the_thickest() -> None:
    problem = problem_with_known_answer((0.0, 0.0, 3.0))
    found = search_haze(true_cloud(problem), problem.sky, problem.target, "srgb", 3)
    assert found.air_depth[0, :2].tolist() == [0.0, 0.0]
    assert 2.5 < float(found.air_depth[0, 2]) <= AIR_DEPTHS[-1]


def test_a_cloud_that_is_no_number_has_no_loss_and_spoils_no_other() -> None:
    problem = problem_with_known_answer()
    cloud = true_cloud(problem).repeat(2, 1, 1)
    cloud[0, 1, 0] = torch.nan
    found = search_haze(cloud, problem.sky, problem.target, "srgb", 2)
    assert found.loss.isnan().tolist() == [[False, True, False], [False, False, False]]
    alone = search_haze(cloud[1:], problem.sky, problem.target, "srgb", 2)
    assert torch.equal(found.loss[1:], alone.loss)
    assert torch.equal(found.air_depth[1:], alone.air_depth)


def test_a_population_is_evaluated_as_its_members_would_be() -> None:
    problem = problem_with_known_answer()
    population = torch.rand(40, problem.space.dimension, generator=torch.Generator().manual_seed(1))
    together = problem.evaluate(population)
    coarse = replace(problem, air_refinements=0).evaluate(population)
    assert bool((together <= coarse).all())
    assert bool((together < coarse).any())
    alone = torch.cat([problem.evaluate(member[None]) for member in population[::13]])
    assert torch.allclose(together[::13], alone, atol=1e-3)
    assert together.std() > 0.01


def test_nodes_that_miss_the_accepted_error_are_left_out_of_the_search() -> None:
    problem = problem_with_known_answer()
    strict = ScatteringStack(problem.stack.tables, largest_image_error=0.0)
    population = TRUTH.repeat(2, 1)
    refused = FitProblem(problem.analysis, strict).evaluate(population)
    assert refused.tolist() == [LOSSES["l1"].worst] * 2
    assert float(problem.evaluate(population).max()) < LOSSES["l1"].worst


def test_free_ambient_light_has_a_colour_and_the_sky_lends_its_own() -> None:
    analysis = made_up_analysis(torch.full((50, 3), 0.8), sky_image())
    free = FitProblem(analysis, small_stack(), "free")
    assert free.space.dimension == 8
    row = free.space.to_physical(torch.tensor([[0.5, 0.5, 0.7, 0.0, 1.0, 1.0, 0.0, 0.0]]))
    red, green, _ = (free.compose(row) - free.compose(row * torch.tensor([1, 1, 1, 1, 0, 1, 1, 1.0])))[0].mean(1)
    assert float(red) > 0.1
    assert float(green) == pytest.approx(0.0, abs=1e-6)
    of_sky = FitProblem(analysis, small_stack(), "sky").lighting(row[:, :5]).ambient_colour
    assert torch.equal(of_sky, analysis.sunlight.ambient_sky_colour)


def test_the_composed_image_is_differentiable() -> None:
    problem = problem_with_known_answer()
    physical = problem.space.to_physical(torch.full((1, 5), 0.6)).requires_grad_()
    problem.compose(physical).mean().backward()
    assert physical.grad is not None
    assert bool(torch.isfinite(physical.grad).all())
    assert bool((physical.grad[0, [0, 3, 4]] > 0.0).all())


def test_sunlight_reaches_the_brightest_grey_but_a_thin_cloud_cannot_be_lit_without_bound() -> None:
    bright = FitProblem(made_up_analysis(torch.full((50, 3), 0.9), sky_image()), small_stack())
    dim = FitProblem(made_up_analysis(torch.full((50, 3), 0.09), sky_image()), small_stack())
    strongest = bright.space.parameters[0].upper
    assert strongest * brightest_radiance(bright.stack) == pytest.approx(1.8, rel=1e-3)
    assert dim.space.parameters[0].upper == pytest.approx(0.1 * strongest, rel=1e-3)


def test_resizing_keeps_the_mean() -> None:
    image = torch.rand(40, 60, 3, generator=torch.Generator().manual_seed(0))
    assert resize_image(image, 15, 10).shape == (10, 15, 3)
    assert torch.allclose(resize_image(image, 15, 10).mean((0, 1)), image.mean((0, 1)), atol=1e-5)
    assert resize_image(image, 90, 60).shape == (60, 90, 3)


def test_the_floor_is_that_of_two_samples_and_falls_with_either() -> None:
    spread = torch.linspace(0.05, 0.95, 400)[:, None].expand(400, 3).contiguous()
    problem = FitProblem(made_up_analysis(spread, sky_image()), small_stack())
    equal = problem.floor_of(400)
    assert equal == pytest.approx(float(l1_floor(problem.target, 400).mean()), rel=1e-6)
    assert problem.floor_of(100) > equal > problem.floor_of(10**9)
    assert problem.floor_of(10**9) == pytest.approx(float(l1_floor(problem.target, 800).mean()), rel=1e-3)
