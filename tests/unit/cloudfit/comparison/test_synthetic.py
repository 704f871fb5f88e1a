import torch

from cloudfit.comparison.synthetic import compose_analysis, draw_truth, true_point
from cloudfit.fit_problem import FitProblem
from cloudfit.fit_types import AIR_STEP
from cloudfit.parameters import cloud_search_space
from tests.support.small_scene import small_stack


def test_the_truth_has_a_loss_of_zero_and_other_points_have_not() -> None:
    stack = small_stack()
    for seed in range(3):
        truth = draw_truth(stack, torch.Generator().manual_seed(seed))
        problem = FitProblem(compose_analysis(stack, truth), stack)
        point = true_point(problem.space, truth.parameters)
        assert point is not None
        assert bool(((point > 0.0) & (point < 1.0)).all()), "inside the searched box"
        assert float(problem.evaluate(point[None])[0]) < 1e-3
        moved = point.clone()
        moved[0] = (moved[0] + 0.3) % 1.0
        assert float(problem.evaluate(moved[None])[0]) > 0.2


def test_equal_seeds_give_equal_truths_on_the_steps_of_the_air() -> None:
    stack = small_stack()
    first, again, other = (draw_truth(stack, torch.Generator().manual_seed(seed)) for seed in (4, 4, 5))
    assert first.parameters == again.parameters != other.parameters
    steps = first.air_depth / AIR_STEP
    assert torch.allclose(steps, steps.round())
    assert 0.8 <= first.parameters["albedo"] <= 1.0


def test_there_is_no_true_point_where_more_is_searched_than_is_known() -> None:
    truth = draw_truth(small_stack(), torch.Generator().manual_seed(0))
    assert true_point(cloud_search_space(100.0, "free"), truth.parameters) is None
