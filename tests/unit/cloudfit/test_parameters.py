"""The map between the unit cube and values in units."""

import math

import pytest
import torch

from cloudfit.parameters import LARGEST_OPTICAL_DEPTH_RANGE, Parameter, SearchSpace, cloud_search_space
from render.errors import ParameterError

SPACE = SearchSpace(
    (Parameter("extinction", "sigma_t", "1/m", 1e-3, 1e1, "log"), Parameter("asymmetry", "g", "1", -0.5, 0.9))
)


def test_corners_and_middle_have_their_closed_forms() -> None:
    unit = torch.tensor([[0.0, 0.0], [1.0, 1.0], [0.5, 0.5], [0.25, 0.25]])
    expected = torch.tensor([[1e-3, -0.5], [1e1, 0.9], [0.1, 0.2], [1e-2, -0.15]])
    torch.testing.assert_close(SPACE.to_physical(unit), expected, rtol=1e-6, atol=1e-7)
    # The middle of a log range is the geometric mean, not the arithmetic one.
    assert abs(float(SPACE.to_physical(unit)[2, 0]) - (1e-3 + 1e1) / 2) > 1


def test_ends_are_exact_in_float32() -> None:
    ends = SPACE.to_physical(torch.tensor([[0.0, 0.0], [1.0, 1.0]]))
    assert ends.dtype == torch.float32
    assert torch.equal(ends, torch.tensor([[1e-3, -0.5], [1e1, 0.9]]))


def test_round_trip() -> None:
    unit = torch.rand(1000, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    torch.testing.assert_close(SPACE.to_unit(SPACE.to_physical(unit)), unit, rtol=0, atol=1e-12)


def test_outside_values_map_outside_the_cube() -> None:
    unit = SPACE.to_unit(torch.tensor([[1e2, 1.6]]))
    torch.testing.assert_close(unit, torch.tensor([[1.25, 1.5]]))


def test_gradients_are_those_of_the_formulas() -> None:
    unit = torch.rand(4, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(2)).requires_grad_()
    physical = SPACE.to_physical(unit)
    (gradient,) = torch.autograd.grad(physical.sum(), unit)
    torch.testing.assert_close(gradient[:, 0], physical[:, 0].detach() * math.log(1e4))
    torch.testing.assert_close(gradient[:, 1], torch.full((4,), 1.4, dtype=torch.float64))
    assert torch.autograd.gradcheck(SPACE.to_physical, (unit,))
    assert torch.autograd.gradcheck(SPACE.to_unit, (SPACE.to_physical(unit).detach().requires_grad_(),))


def test_gradient_survives_a_linear_value_with_no_logarithm() -> None:
    physical = torch.tensor([[1.0, -0.5]]).requires_grad_()
    (gradient,) = torch.autograd.grad(SPACE.to_unit(physical).sum(), physical)
    assert bool(gradient.isfinite().all())


def test_gradient_survives_a_linear_range_with_no_exponential() -> None:
    wide = SearchSpace((Parameter("count", "n", "1", 0.0, 1e6), Parameter("extinction", "s", "1/m", 1e-3, 1.0, "log")))
    unit = torch.tensor([[0.9, 0.5]]).requires_grad_()
    (gradient,) = torch.autograd.grad(wide.to_physical(unit).sum(), unit)
    assert bool(gradient.isfinite().all())


def test_as_dict_keeps_the_order() -> None:
    assert list(SPACE.as_dict(torch.tensor([2.0, 0.5]))) == ["extinction", "asymmetry"]
    assert SPACE.as_dict([2.0, 0.5]) == {"extinction": 2.0, "asymmetry": 0.5}


@pytest.mark.parametrize("shape", [(2,), (3, 3), (1, 1), (2, 2, 2)])
def test_shape_errors_show_both_shapes(shape: tuple[int, ...]) -> None:
    for convert in (SPACE.to_physical, SPACE.to_unit):
        with pytest.raises(ParameterError, match=r"\(any, 2\), got \(" + str(shape[0])):
            convert(torch.zeros(shape))


def test_other_arguments_are_refused() -> None:
    with pytest.raises(ParameterError, match=r"\(2,\), got \(3,\)"):
        SPACE.as_dict(torch.zeros(3))
    with pytest.raises(ParameterError, match=r"float.*int64"):
        SPACE.to_physical(torch.zeros(1, 2, dtype=torch.int64))
    with pytest.raises(ParameterError, match="positive values of extinction"):
        SPACE.to_unit(torch.tensor([[0.0, 0.5]]))
    with pytest.raises(ParameterError, match="distinct"):
        SearchSpace((SPACE.parameters[0], SPACE.parameters[0]))
    with pytest.raises(ParameterError, match="at least one"):
        SearchSpace(())


@pytest.mark.parametrize(
    ("lower", "upper", "scale", "message"),
    [
        (1.0, 1.0, "linear", "lower < upper"),
        (2.0, 1.0, "linear", "lower < upper"),
        (math.nan, 1.0, "linear", "finite"),
        (0.0, math.inf, "linear", "finite"),
        (0.0, 1.0, "log", "lower > 0"),
        (0.1, 1.0, "cubic", "'linear' or 'log'"),
    ],
)
def test_impossible_parameters_are_refused(lower: float, upper: float, scale: str, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        Parameter("albedo", "beta", "1", lower, upper, scale)  # type: ignore[arg-type]


def test_cloud_search_space_is_the_papers_in_its_order() -> None:
    space = cloud_search_space(largest_optical_length=500.0)
    assert space.names == ("sunlight_intensity", "asymmetry", "extinction", "albedo", "ambient")
    assert [parameter.scale for parameter in space.parameters] == ["log", "linear", "log", "linear", "linear"]
    ends = space.to_physical(torch.tensor([[0.0] * 5, [1.0] * 5], dtype=torch.float64))
    depths = ends[:, 2] * 500.0
    torch.testing.assert_close(depths, torch.tensor(LARGEST_OPTICAL_DEPTH_RANGE, dtype=torch.float64))


def test_extinction_range_scales_inversely_with_lengths() -> None:
    small, large = cloud_search_space(2.0), cloud_search_space(2000.0)
    unit = torch.rand(5, 5, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    ratio = small.to_physical(unit) / large.to_physical(unit)
    torch.testing.assert_close(ratio[:, 2], torch.full((5,), 1000.0, dtype=torch.float64))
    torch.testing.assert_close(ratio[:, [0, 1, 3, 4]], torch.ones(5, 4, dtype=torch.float64))


def test_ambient_light_of_a_free_colour_adds_three_parameters() -> None:
    assert cloud_search_space(1.0, ambient="sky").dimension == 5
    space = cloud_search_space(1.0, ambient="free", asymmetry_range=(0.1, 0.5), extinction_range=(0.2, 0.4))
    assert space.names[5:] == ("ambient_red", "ambient_green", "ambient_blue")
    assert (space.parameters[1].lower, space.parameters[2].upper) == (0.1, 0.4)


@pytest.mark.parametrize("length", [0.0, -1.0, math.nan, math.inf])
def test_a_volume_out_of_view_is_named(length: float) -> None:
    with pytest.raises(ParameterError, match="in view"):
        cloud_search_space(length)


def test_an_unknown_ambient_colour_is_named() -> None:
    with pytest.raises(ParameterError, match="'moon'"):
        cloud_search_space(1.0, ambient="moon")  # type: ignore[arg-type]
