"""Fog against adaptive quadrature: random configurations with every singular direction, gradients, limits and sweeps."""

import itertools
import math

import numpy as np
import pytest
import torch

from render.errors import ParameterError
from render.media import (
    MEDIA,
    ExponentialDecay,
    LinearDecay,
    Uniform,
    compute_curved_in_scattering,
    compute_in_scattering,
    compute_optical_depth,
    compute_section_in_scattering,
    compute_transmittance,
)
from tests.support.fog_cases import FogCases, draw_cases
from tests.support.fog_quadrature import integrate_fog

TOLERANCE = 1e-9
OPAQUE = 700.0
"""Optical depth above which exp(-depth) is 0 in float64, or nearly: the quadrature cuts deeper rays."""


def worst_error(value: np.ndarray, expected: np.ndarray) -> float:
    """Largest relative error; NaN counts as infinite, and numbers below 1e-290 as 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.where(value == expected, 0.0, np.abs(value - expected) / np.maximum(np.abs(expected), 1e-290))
    return float(np.nan_to_num(error, nan=np.inf).max())


def evaluate(cases: FogCases, sun_slope: torch.Tensor) -> np.ndarray:
    return compute_in_scattering(cases.medium, cases.height, cases.slope, sun_slope, cases.distance).numpy()


def compare_with_quadrature(name: str, count: int, seed: int) -> tuple[float, float]:
    """Largest relative errors of optical depth and in-scattering; asserts that wrong formulas have large ones."""
    cases = draw_cases(name, count, seed)
    depth, scattered = integrate_fog(cases.fog, cases.rays)
    ours = compute_optical_depth(cases.medium, cases.height, cases.slope, cases.distance).numpy()
    value = evaluate(cases, cases.sun_slope)
    assert (scattered > 1e-12).mean() > 0.25
    assert worst_error(evaluate(cases, -cases.sun_slope), scattered) > 0.5
    halved = compute_in_scattering(cases.medium, cases.height, cases.slope, cases.sun_slope, 0.999 * cases.distance)
    assert worst_error(halved.numpy(), scattered) > 1e-4
    clear = (ours < OPAQUE) & (depth < OPAQUE)
    assert ((ours >= OPAQUE) == (depth >= OPAQUE)).all()
    return worst_error(ours[clear], depth[clear]), worst_error(value, scattered)


@pytest.mark.parametrize("name", MEDIA)
def test_every_formula_is_its_integral(name: str) -> None:
    assert max(compare_with_quadrature(name, 400, seed=1)) < TOLERANCE


@pytest.mark.slow
@pytest.mark.parametrize("name", MEDIA)
def test_every_formula_is_its_integral_ten_thousand_times(name: str) -> None:
    errors = [compare_with_quadrature(name, 1000, seed) for seed in range(10, 20)]
    print(name, "largest relative errors of depth and in-scattering:", np.max(errors, axis=0))
    assert np.max(errors) < TOLERANCE


def test_what_the_source_prints_fails_the_same_comparison() -> None:
    """The misprints that the docstrings of the media list, each put into an otherwise right formula."""
    cases = draw_cases("uniform", 200, seed=3)
    _, scattered = integrate_fog(cases.fog, cases.rays)
    right = evaluate(cases, cases.sun_slope)
    rate = (1.0 - cases.slope / cases.sun_slope).abs() * cases.medium.extinction_at(cases.height)
    assert worst_error(right * rate.nan_to_num(1.0).numpy(), scattered) > 0.5
    cases = draw_cases("exponential", 200, seed=3)
    depth, _ = integrate_fog(cases.fog, cases.rays)
    medium = cases.medium
    assert isinstance(medium, ExponentialDecay)
    without_height = compute_optical_depth(medium, torch.as_tensor(medium.reference), cases.slope, cases.distance)
    steeper = ExponentialDecay(medium.extinction, 2.0 * medium.scale_height, medium.base, medium.reference)
    assert worst_error(without_height.numpy(), depth) > 0.5
    assert worst_error(compute_optical_depth(steeper, cases.height, cases.slope, cases.distance).numpy(), depth) > 0.5


SMOOTH = {
    "uniform": lambda e, h: Uniform(e, h),
    "linear": lambda e, h: LinearDecay(e, h),
    "exponential": lambda e, h: ExponentialDecay(e, 0.4 * h),
}
VIEWS = [
    (0.0, 0.3, 250.0),
    (0.3, 0.3, 40.0),
    (-0.02, 0.5, 60.0),
    (0.4, 0.3, math.inf),
    (-0.3, 0.7, math.inf),
    (0.1, -0.4, 30.0),
]


@pytest.mark.parametrize("name", MEDIA)
@pytest.mark.parametrize("view", VIEWS)
def test_gradients_are_those_of_differences(name: str, view: tuple[float, float, float]) -> None:
    slope, sun_slope, distance = view

    def scattered(*values: torch.Tensor) -> torch.Tensor:
        extinction, thickness, height, v, l = values  # noqa: E741
        medium = SMOOTH[name](extinction, thickness)
        return compute_in_scattering(medium, height, v, l, distance) + compute_transmittance(
            medium, height, v, distance
        )

    values = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.02, 90.0, 35.0, slope, sun_slope)]
    assert torch.autograd.gradcheck(scattered, values, rtol=1e-6, atol=1e-9)
    gradient = torch.autograd.grad(scattered(*values), values)
    assert all(bool(torch.isfinite(g)) for g in gradient)
    assert float(gradient[0].abs()) > 1e-3


@pytest.mark.parametrize("name", MEDIA)
def test_nothing_jumps_across_singular_directions(name: str) -> None:
    """Sweeps over v = 0, l = 0, v = l and lengths from 0 up: neighbours differ by little, down to the smallest steps."""
    medium = SMOOTH[name](0.02, 100.0)
    tiny = torch.logspace(-18, -2, 33, dtype=torch.float64)
    around = torch.cat([-tiny.flip(0), torch.zeros(1, dtype=torch.float64), tiny])
    still = torch.full_like(around, 0.25)
    for slope, sun, distance in (
        (around, still, 300.0),
        (around, still, math.inf),
        (still + around, still, 300.0),
        (-still, around.clamp(min=0.0), 300.0),
        (still, still, torch.cat([torch.zeros(34, dtype=torch.float64), tiny])),
    ):
        value = compute_in_scattering(medium, 40.0, slope, sun, distance)
        assert torch.isfinite(value).all()
        assert (value >= 0.0).all()
        assert value.diff().abs().max() < 0.02 * max(1.0, float(value.max()))
        assert value[30:36].diff().abs().max() < 1e-12
    assert compute_in_scattering(medium, 40.0, still, still, 300.0)[0] > 0.01


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", MEDIA)
def test_extremes_are_finite_and_have_their_limits(name: str, dtype: torch.dtype) -> None:
    heights = torch.tensor([-1e3, 0.0, 50.0, 100.0, 1e7], dtype=dtype)[:, None, None, None]
    slopes = torch.tensor([-1.0, -1e-30, 0.0, 1e-30, 0.5, 1.0], dtype=dtype)[:, None, None]
    suns = torch.tensor([-1.0, -1e-12, 0.0, 1e-12, 0.5, 1.0], dtype=dtype)[:, None]
    distances = torch.tensor([0.0, 1e-30, 10.0, 1e9, math.inf], dtype=dtype)
    for extinction in (0.0, 1e-12, 0.01, 100.0):
        medium = SMOOTH[name](extinction, 100.0)
        scattered = compute_in_scattering(medium, heights, slopes, suns, distances)
        passed = compute_transmittance(medium, heights, slopes, distances)
        curved = compute_curved_in_scattering(medium, heights, slopes, suns, 6.4e6, distances)
        for value in (scattered, passed, curved):
            assert value.dtype == dtype
            assert ((value >= 0.0) & (value <= 1.0 + 1e-6)).all()
        assert (scattered + passed <= 1.0 + 1e-6).all()
        assert (scattered[..., 0] == 0.0).all()
        assert (passed[..., 0] == 1.0).all()
        if extinction == 0.0:
            assert (scattered == 0.0).all()
            assert (passed == 1.0).all()


@pytest.mark.parametrize("name", MEDIA)
def test_single_precision_is_usable(name: str) -> None:
    cases = draw_cases(name, 2000, seed=4)
    medium = SMOOTH[name](0.02, 100.0)
    rays = [v.float() for v in (cases.height.clamp(0.0, 300.0), cases.slope, cases.sun_slope, cases.distance)]
    single = compute_in_scattering(medium, *rays)
    double = compute_in_scattering(medium, *(v.double() for v in rays))
    torch.testing.assert_close(single.double(), double, rtol=2e-4, atol=1e-6)


@pytest.mark.parametrize("name", MEDIA)
def test_parts_of_a_ray_add_up(name: str) -> None:
    medium = SMOOTH[name](0.02, 100.0)
    height, slope = (
        torch.tensor([150.0, 20.0, 60.0], dtype=torch.float64),
        torch.tensor([-0.5, 0.0, 0.4], dtype=torch.float64),
    )
    whole = compute_in_scattering(medium, height, slope, 0.6)
    edges = [0.0, 3.0, 120.0, math.inf]
    parts = [compute_section_in_scattering(medium, height, slope, 0.6, a, b) for a, b in itertools.pairwise(edges)]
    torch.testing.assert_close(torch.stack(parts).sum(0), whole, rtol=1e-12, atol=0.0)
    assert float((parts[1] - whole).abs().max()) > 0.1


def test_closed_forms_by_hand() -> None:
    """Straight down from above with the sun overhead: (1 - exp(-2 tau)) / 2; sideways through a uniform layer."""
    for medium, vertical in (
        (Uniform(0.01, 100.0), 1.0),
        (LinearDecay(0.01, 100.0), 0.5),
        (ExponentialDecay(0.01, 100.0), 1.0),
    ):
        value = compute_in_scattering(medium, torch.tensor(5e3, dtype=torch.float64), -1.0, 1.0)
        assert float(value) == pytest.approx(-0.5 * math.expm1(-2.0 * vertical), rel=1e-10)
    level = compute_in_scattering(Uniform(0.01, 100.0), torch.tensor(20.0, dtype=torch.float64), 0.0, 0.5, 70.0)
    assert float(level) == pytest.approx(math.exp(-0.01 * 80.0 / 0.5) * (1.0 - math.exp(-0.7)), rel=1e-13)


def test_rays_that_are_none_are_refused() -> None:
    medium = Uniform(0.01, 100.0)
    for height, slope, distance, words in (
        (math.inf, 0.0, 1.0, "heights"),
        (0.0, 1.5, 1.0, "slopes"),
        (0.0, math.nan, 1.0, "slopes"),
        (0.0, 0.0, -1.0, "distances"),
        (0.0, 0.0, math.nan, "distances"),
    ):
        with pytest.raises(ParameterError, match=words):
            compute_optical_depth(medium, height, slope, distance)
    with pytest.raises(ParameterError, match="slopes"):
        compute_in_scattering(medium, 0.0, 0.0, 2.0)
