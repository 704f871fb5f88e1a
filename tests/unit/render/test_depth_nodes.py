"""The coordinate of a table's extinctions: linear for thin clouds, logarithmic for thick ones, nodes evenly spaced in it."""

import math

import pytest
import torch

from render.depth_nodes import FEWEST_NODES, SOFT_DEPTH, count_depths, depth_coordinate, place_depths, step_of_depths
from render.errors import ParameterError


def test_the_coordinate_is_linear_where_thin_and_logarithmic_where_thick() -> None:
    thin = torch.tensor([1e-6, 2e-6], dtype=torch.float64)
    torch.testing.assert_close(depth_coordinate(thin, 0.5), thin / 0.5, rtol=1e-5, atol=0.0)
    thick = torch.tensor([1e6, 2e6], dtype=torch.float64)
    torch.testing.assert_close(depth_coordinate(thick, 0.5), (thick / 0.5).log(), rtol=1e-6, atol=0.0)
    assert float(depth_coordinate(torch.tensor(0.5), 0.5)) == pytest.approx(math.log(2.0))


@pytest.mark.parametrize(
    ("thin", "thick", "count"), [(0.05, 60.0, 11), (0.05, 200.0, 8), (1e-6, 1e4, 15), (1.0, 2.0, 2)]
)
def test_nodes_are_evenly_spaced_in_it(thin: float, thick: float, count: int) -> None:
    depth = place_depths(thin, thick, count)
    assert len(depth) == count
    assert float(depth[0]) == pytest.approx(thin)
    assert float(depth[-1]) == pytest.approx(thick)
    step = depth_coordinate(depth, SOFT_DEPTH).diff()
    torch.testing.assert_close(step, step.mean().expand(count - 1), rtol=1e-9, atol=0.0)


def test_thick_neighbours_are_closer_than_on_a_logarithmic_scale() -> None:
    depth = place_depths(0.05, 60.0, 11)
    logarithmic = (60.0 / 0.05) ** 0.1
    growth = depth[1:] / depth[:-1]
    assert float(growth[0]) > 10.0
    assert float(growth[3:].max()) < 0.9 * logarithmic
    assert (growth.diff() < 0).all()


@pytest.mark.parametrize(("thin", "thick"), [(0.05, 60.0), (0.05, 200.0), (1e-6, 1e4), (30.0, 60.0)])
@pytest.mark.parametrize("step", [0.1, 0.46, 0.66])
def test_no_more_nodes_than_a_step_needs(thin: float, thick: float, step: float) -> None:
    count = count_depths(thin, thick, step)
    taken = float(depth_coordinate(place_depths(thin, thick, count), SOFT_DEPTH).diff()[0])
    assert taken <= step * (1.0 + 1e-9)
    assert count == FEWEST_NODES or taken * (count - 1) / (count - 2) > step


def test_thin_clouds_need_few_nodes_and_never_fewer_than_three() -> None:
    assert count_depths(0.005, 0.05, 0.46) == count_depths(1e-6, 1e-5, 0.1) == count_depths(1.0, 1.0001, 3.0) == 3
    assert count_depths(0.05, 2.0, 0.46) == 3


@pytest.mark.parametrize(
    ("thin", "thick"), [(2.0, 0.5), (1.0, 1.0), (0.0, 1.0), (-1.0, 1.0), (1.0, math.inf), (math.nan, 1.0)]
)
def test_depths_that_do_not_rise_from_above_zero_are_refused(thin: float, thick: float) -> None:
    for call in (count_depths, step_of_depths, place_depths):
        with pytest.raises(ParameterError, match="must rise from above zero"):
            call(thin, thick, 3)


@pytest.mark.parametrize("count", [3, 4, 10, 57])
def test_the_step_of_a_number_of_nodes_gives_that_number(count: int) -> None:
    assert count_depths(0.05, 60.0, step_of_depths(0.05, 60.0, count)) == count
