from dataclasses import replace

import pytest
import torch
from torch import Tensor

from cloudfit.cloud_mask import CloudMask, Label
from cloudfit.fit_problem import FitProblem, brightest_radiance, resize_image
from cloudfit.losses import LOSSES, l1_floor
from cloudfit.soft_haze import display_values
from render.cloud_image import blend_air
from render.errors import ParameterError
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


def problem_in_place(loss: str, stack: ScatteringStack | None = None) -> FitProblem:
    """The photograph is the stack's own image of TRUTH behind some air, each pixel in its place."""
    stack = stack or small_stack()
    tables = small_stack().tables
    sky = SKY.expand(tables.height, tables.width, 3).clone()
    guess = FitProblem(made_up_analysis(torch.full((50, 3), 0.8), sky), small_stack())
    cloud = guess.compose(guess.space.to_physical(TRUTH))
    image = sky.flatten(0, 1).clone()
    image[guess.stack.pixel[guess.counted]] = blend_air(cloud, guess.sky, torch.tensor([[0.0, 0.3, 0.6]]))[0].T
    analysis = made_up_analysis(torch.full((1, 3), 0.8), sky)
    labels = torch.full((len(image),), int(Label.SKY), dtype=torch.uint8)
    labels[guess.stack.pixel[guess.counted]] = int(Label.CLOUD)
    photograph = replace(analysis.photograph, pixels=image.reshape(sky.shape))
    mask = CloudMask(labels.reshape(sky.shape[:2]))
    return FitProblem(replace(analysis, photograph=photograph, mask=mask), stack, loss=loss)


@pytest.mark.parametrize("name", LOSSES)
def test_every_loss_is_smallest_at_the_truth(name: str) -> None:
    problem = problem_in_place(name)
    truth = guess_space_truth(problem)
    others = truth.repeat(5, 1)
    others[range(5), range(5)] = (others.diagonal() * 0.5).clamp(min=0.05)
    losses = problem(torch.cat([truth, others]))
    assert losses.dtype == torch.float64
    # Levels are rounded, and a pixel on the border between two may take either.
    assert float(losses[0]) < 0.1 * float(losses[1:].min()) + 1e-6
    assert torch.equal(losses, problem.evaluate(torch.cat([truth, others])))
    assert 0.0 <= float(losses[0]) <= problem.floor or LOSSES[name].name == "squared_difference"


@pytest.mark.parametrize("name", LOSSES)
def test_candidates_left_out_have_the_worst_loss_and_no_slope(name: str) -> None:
    problem = problem_in_place(name, ScatteringStack(small_stack().tables, largest_image_error=0.0))
    assert problem(TRUTH).tolist() == [LOSSES[name].worst]
    if LOSSES[name].is_differentiable:
        losses, gradient = problem.with_gradient(TRUTH)
        assert losses.tolist() == [LOSSES[name].worst]
        assert gradient.tolist() == [[0.0] * 5]


@pytest.mark.parametrize("name", LOSSES)
def test_only_problems_with_a_differentiable_loss_have_gradients(name: str) -> None:
    assert hasattr(problem_in_place(name), "with_gradient") is LOSSES[name].is_differentiable


def test_an_unknown_loss_is_refused() -> None:
    with pytest.raises(ParameterError, match="no loss is called 'l3'"):
        replace(problem_with_known_answer(), loss="l3")


def points_with_bounds(count: int) -> Tensor:
    """Random points, a quarter of the coordinates on a bound, in float64."""
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(count, 5, generator=generator, dtype=torch.float64)
    choice = torch.rand(count, 5, generator=generator)
    return points.masked_fill(choice < 0.12, 0.0).masked_fill(choice > 0.88, 1.0)


def differences(problem: FitProblem, points: Tensor, step: float) -> Tensor:
    """Central differences, and at a bound one-sided ones of the second order."""
    columns = []
    here = problem(points)
    for number in range(points.shape[1]):
        move = step * torch.eye(points.shape[1], dtype=points.dtype)[number]
        central = (problem(points + move) - problem(points - move)) / (2.0 * step)
        forward = (4.0 * problem(points + move) - problem(points + 2.0 * move) - 3.0 * here) / (2.0 * step)
        backward = (3.0 * here - 4.0 * problem(points - move) + problem(points - 2.0 * move)) / (2.0 * step)
        place = points[:, number]
        columns.append(torch.where(place == 0.0, forward, torch.where(place == 1.0, backward, central)))
    return torch.stack(columns, dim=1)


@pytest.mark.parametrize("name", [name for name, loss in LOSSES.items() if loss.is_differentiable])
def test_gradients_are_those_of_differences_also_on_the_bounds(name: str) -> None:
    problem = problem_in_place(name, ScatteringStack(small_stack().tables).double())
    points = points_with_bounds(30)
    losses, gradient = problem.with_gradient(points)
    assert gradient.dtype == torch.float64
    assert torch.equal(losses, problem(points))
    # So short a step seldom crosses a kink (a pixel that changes its level, two that change their rank); where it does, differences
    # with other steps differ.
    expected, other = differences(problem, points, 1e-7), differences(problem, points, 3e-7)
    smooth = (expected - other).norm(dim=1) < 3e-5 * expected.norm(dim=1) + 1e-6
    assert int(smooth.sum()) >= 20
    error = (gradient - expected).norm(dim=1)
    size = expected.norm(dim=1)
    # Histograms that share no level have no slope at all, and the differences nothing but rounding.
    sloping = (size > 1e-6) & smooth
    assert int(sloping.sum()) > 15
    assert float((error / size)[sloping].max()) < 1e-4
    assert float(gradient[size <= 1e-6].abs().sum()) < 1e-5
    assert float(((gradient + expected).norm(dim=1) / size)[sloping].min()) > 1.0
    # In float32 the same point may lie on another side of a kink, so the bulk is compared.
    single = problem_in_place(name)
    rough = single.with_gradient(points.float())[1]
    assert rough.dtype == torch.float32
    assert float(((rough - gradient).norm(dim=1) / size)[sloping].median()) < 1e-2


def test_floors_are_in_the_units_of_their_loss_and_fall_with_the_pixels() -> None:
    floors = {name: problem_in_place(name).floor_of(256) for name in LOSSES}
    assert floors["squared_difference"] == 0.0
    assert floors["intersection"] == pytest.approx(0.5 * floors["l1"], rel=0.1)
    assert floors["sorted_wasserstein"] == pytest.approx(floors["wasserstein"], rel=0.2)
    assert 0.0 < floors["soft_l1"] < floors["l1"]
    for name in set(LOSSES) - {"squared_difference"}:
        assert problem_in_place(name).floor_of(4) > 1.4 * floors[name] > 0.0


def test_coarse_air_is_never_better_and_takes_no_other_point() -> None:
    problem = problem_with_known_answer()
    population = torch.rand(40, problem.space.dimension, generator=torch.Generator().manual_seed(1))
    full, coarse = problem(population), replace(problem, coarse_air=True, air_refinements=0)(population)
    assert bool((coarse >= replace(problem, air_refinements=0)(population)).all())
    assert float((coarse - full).median()) < 0.1


def test_appearances_tell_what_a_parameter_does() -> None:
    problem = problem_with_known_answer()
    lit, brighter = torch.tensor([[0.5, 0.3, 0.7, 0.9, 0.2]]), torch.tensor([[0.6, 0.3, 0.7, 0.9, 0.2]])
    black = torch.tensor([[0.2, 0.3, 0.7, 0.0, 0.2], [0.9, 0.8, 0.7, 0.0, 0.2]])
    levels = problem.appearance(torch.cat([lit, brighter, black]))
    assert levels.shape[1] % 3 == 0
    assert 0.0 <= float(levels.min()) < float(levels.max()) <= 255.0
    assert float((levels[1] - levels[0]).mean()) > 1.0
    assert torch.equal(levels[2], levels[3]), "neither sunlight nor asymmetry can be seen in a black cloud"
    # The whole picture says the same.
    whole = problem.compose(problem.space.to_physical(lit))
    assert float(levels[0].mean()) == pytest.approx(255.0 * float(display_values(whole, "srgb").mean()), rel=0.05)
