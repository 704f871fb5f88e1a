"""The linear search over the air."""

import pytest
import torch
from torch import Tensor

from cloudfit.air_search import Comparison, search_depths, search_haze
from cloudfit.colour_histogram import haze_histograms
from cloudfit.fit_types import AIR_DEPTHS, AIR_REFINEMENTS
from cloudfit.losses import LOSSES, PhotographValues, PixelLoss
from cloudfit.soft_haze import display_values
from render.cloud_image import blend_air
from tests.unit.cloudfit.test_fit_problem import problem_with_known_answer, true_cloud


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
    # A ninth and a third of a step from one of the 11, and a third above no air at all.
    air = (1.2 + 0.1 / 3, 0.7, 0.1)
    problem = problem_with_known_answer(air)
    coarse, once, twice = (
        search_haze(true_cloud(problem), problem.sky, problem.target, "srgb", number) for number in range(3)
    )
    assert coarse.air_depth[0].tolist() == pytest.approx([1.2, 0.6, 0.0])
    assert once.air_depth[0].tolist() == pytest.approx([1.2, 0.7, 0.1])
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


def image_of_many_shades(pixels: int = 600) -> tuple[Tensor, Tensor]:
    """Cloud `(1, 3, pixel)` and sky `(3, pixel)`."""
    generator = torch.Generator().manual_seed(4)
    return torch.rand(1, 3, pixels, generator=generator), 0.3 * torch.rand(3, pixels, generator=generator)


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.parametrize("thirds", [False, True])
def test_any_loss_finds_the_air_of_each_channel(name: str, thirds: bool) -> None:
    air = torch.tensor([[0.0, 0.6 + 0.1, 2.4 + 0.1 / 3]])
    cloud, sky = image_of_many_shades()
    seen = blend_air(cloud, sky, air)
    values = display_values(seen[0], "srgb")
    histogram = haze_histograms(seen, sky, (1.0,))[0, 0]
    loss = LOSSES[name]
    target = loss.prepare(PhotographValues(values, values)) if isinstance(loss, PixelLoss) else histogram
    if thirds and name == "chi_square":
        pytest.skip(
            "chi-square jumps wherever a level of the photograph holds a single pixel, and leads the coarse steps astray"
        )
    found = Comparison(loss, target, histogram, "srgb").search(cloud, sky, AIR_REFINEMENTS, thirds)
    assert found.air_depth[0].tolist() == pytest.approx(air[0].tolist(), abs=1e-6)
    assert float(found.loss.max()) < 0.02
    assert float((found.histogram - histogram).abs().sum(-1).max()) < 0.02
    stained = cloud.clone()
    stained[0, 1, 5] = torch.inf
    lost = Comparison(loss, target, histogram, "srgb").find_air(stained, sky, 0).loss
    assert lost.isnan().tolist() == [[False, True, False]]


def test_thirds_reach_every_step_of_the_paper_with_six_comparisons() -> None:
    for best in AIR_DEPTHS:
        tried: list[Tensor] = []

        def score(depths: Tensor, best: float = best, tried: list[Tensor] = tried) -> Tensor:
            tried.append(depths)
            return (depths - best).abs()

        found = search_depths(score, 1, 1, 0, thirds=True)
        assert float(found.air_depth) == pytest.approx(best)
        assert sum(depths.shape[1] for depths in tried) == 6
        assert search_depths(score, 1, 1, 0).air_depth.tolist() == [[best]]


def test_thirds_may_miss_a_narrow_valley() -> None:
    def score(depths: Tensor) -> Tensor:
        return torch.where((depths - AIR_DEPTHS[4]).abs() < 0.1, 0.0, 1.0 + (depths - AIR_DEPTHS[9]).abs())

    assert float(search_depths(score, 1, 1, 0).loss) == 0.0
    assert float(search_depths(score, 1, 1, 0, thirds=True).loss) > 0.0
