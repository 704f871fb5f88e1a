"""The coordinate of a table's extinctions: linear for thin clouds, logarithmic for thick ones, nodes evenly spaced in it."""

import math

import pytest
import torch

from render.depth_nodes import SOFT_DEPTH, depth_coordinate, place_depths


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
