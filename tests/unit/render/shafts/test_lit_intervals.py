import pytest
import torch

from render.errors import ParameterError
from render.shafts.lit_intervals import LitIntervals, join_touching


def intervals(*parts: tuple[int, float, float], rays: int = 3) -> LitIntervals:
    ray, start, end = zip(*parts, strict=True)
    return join_touching(torch.tensor(ray), torch.tensor(start), torch.tensor(end), rays)


def test_stretches_that_touch_are_joined_and_others_are_not() -> None:
    found = intervals((2, 0.5, 1.0), (0, 0.5, 0.75), (0, 0.25, 0.5), (2, 0.0, 0.25))
    assert found.ray.tolist() == [0, 2, 2]
    assert found.start.tolist() == [0.25, 0.0, 0.5]
    assert found.end.tolist() == [0.75, 0.25, 1.0]
    apart = intervals((0, 0.0, 0.5), (1, 0.5, 1.0))
    assert len(apart.ray) == 2


def test_lengths_are_added_up_ray_by_ray() -> None:
    assert intervals((2, 0.5, 1.0), (2, 0.0, 0.25), (0, 0.0, 0.125)).lit_fraction().tolist() == [0.125, 0.0, 0.75]


def test_samples_within_a_stretch_are_lit_and_its_ends_belong_to_it() -> None:
    found = intervals((0, 0.25, 0.5), (0, 0.75, 1.0), (2, 0.0, 1.0))
    lit = found.contains(torch.tensor([0.0, 0.25, 0.4, 0.5, 0.6, 1.0]))
    assert lit.tolist() == [[False, True, True, True, False, True], [False] * 6, [True] * 6]


def test_the_integral_over_lit_stretches_is_that_of_the_function() -> None:
    """F = x^2 on a fine table; the stretches 0.2..0.5 and 0.9..1 hold 0.25 - 0.04 + 1 - 0.81."""
    places = torch.linspace(0.0, 1.0, 1001, dtype=torch.float64)
    table = torch.stack([places**2, places], dim=1).expand(3, -1, -1)
    ray, start, end = torch.tensor([1, 1]), torch.tensor([0.2, 0.9]), torch.tensor([0.5, 1.0])
    found = LitIntervals(ray, start.double(), end.double(), 3).integrate(places, table)
    assert found[1].tolist() == pytest.approx([0.40, 0.40], abs=1e-6)
    assert found[0].tolist() == found[2].tolist() == [0.0, 0.0]
    longer = LitIntervals(ray, start.double() - 0.01, end.double(), 3).integrate(places, table)
    assert longer[1, 0].item() != pytest.approx(0.40, abs=1e-3)


def test_a_ray_that_is_lit_throughout_has_the_whole_integral() -> None:
    table = torch.tensor([[[0.0], [2.0], [3.0]]])
    found = intervals((0, 0.0, 1.0), rays=1).integrate(torch.tensor([0.0, 0.9, 1.0]), table)
    assert found.tolist() == [[3.0]]


def test_tables_that_do_not_fit_are_refused() -> None:
    found = intervals((0, 0.0, 1.0), rays=1)
    with pytest.raises(ParameterError, match="rising"):
        found.contains(torch.tensor([0.5, 0.2]))
    with pytest.raises(ParameterError, match="shape"):
        found.integrate(torch.tensor([0.0, 1.0]), torch.zeros(2, 2, 1))
    with pytest.raises(ParameterError, match="from 0 to 1"):
        found.integrate(torch.tensor([0.0, 0.9]), torch.zeros(1, 2, 1))
