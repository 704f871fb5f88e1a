import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from scipy import integrate, special

from render.media.special_functions import exponential_mean, exponential_moment, log_ratio, scaled_erfc

RATES = [-60.0, -3.0, -1.0, -0.999, -1e-3, -1e-9, 0.0, 1e-300, 1e-12, 1e-5, 0.3, 0.9999, 1.0, 1.0001, 5.0, 40.0, 1e4]


def tensor(values: list[float]) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64, requires_grad=True)


def moment(x: float, power: int) -> float:
    """By quadrature in panels that resolve the exponential; far from 0 all of it lies within 45 / |x| of one end."""
    cut = min(1.0, 45.0 / abs(x)) if x else 1.0
    low, high = (0.0, cut) if x > 0.0 else (1.0 - cut, 1.0)
    edges = np.linspace(low, high, 13)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    s = (edges[:-1, None] + (edges[1] - edges[0]) * 0.5 * (nodes + 1.0)).ravel()
    return float((np.tile(weights, 12) * s**power * np.exp(-x * s)).sum() * 0.5 * (edges[1] - edges[0]))


@pytest.mark.parametrize("power", [0, 1, 2, 3])
def test_moments_are_their_integrals(power: int) -> None:
    value = exponential_moment(tensor(RATES), power).detach().numpy()
    expected = np.array([moment(x, power) for x in RATES])
    np.testing.assert_allclose(value, expected, rtol=2e-13)
    assert np.abs(value[:-1] / [moment(-x, power) for x in RATES[:-1]] - 1.0).max() > 0.1


def test_moments_have_moments_as_derivatives_at_zero_too() -> None:
    x = tensor(RATES)
    (slope,) = torch.autograd.grad(exponential_moment(x).sum(), x, create_graph=True)
    np.testing.assert_allclose(slope.detach().numpy(), [-moment(r, 1) for r in RATES], rtol=2e-13)
    (bend,) = torch.autograd.grad(slope.sum(), x)
    np.testing.assert_allclose(bend.numpy(), [moment(r, 2) for r in RATES], rtol=2e-13)


def test_the_derivative_of_the_quotient_would_lose_its_digits() -> None:
    x = tensor([1.1e-9, 2.3e-9, 3.7e-9, 5.9e-9])
    (naive,) = torch.autograd.grad((-torch.expm1(-x) / x).sum(), x)
    assert (naive + 0.5).abs().max() > 1e-8
    (ours,) = torch.autograd.grad(exponential_moment(x).sum(), x)
    assert (ours + 0.5).abs().max() < 3e-9


def test_the_mean_of_an_exponential_between_any_two_exponents() -> None:
    first, last = (
        tensor([0.0, 2.0, 1e3, 5.0, math.inf, math.inf, 3.0]),
        tensor([0.0, 2.0, 1.0, 5.0 + 1e-12, math.inf, 1.0, 900.0]),
    )
    value = exponential_mean(first, last)
    expected = [1.0, math.exp(-2.0), math.exp(-1.0) / 999.0, math.exp(-5.0), 0.0, 0.0, math.exp(-3.0) / 897.0]
    torch.testing.assert_close(value, torch.tensor(expected, dtype=torch.float64), rtol=1e-11, atol=0.0)
    torch.testing.assert_close(value, exponential_mean(last, first))
    value.sum().backward()
    assert first.grad is not None
    assert first.grad[1].item() == pytest.approx(-0.5 * math.exp(-2.0))
    assert torch.isfinite(first.grad).all()


def unit_integral(function: Callable[[float], float]) -> float:
    return integrate.quad(function, 0.0, 1.0, epsabs=0.0, epsrel=1e-12)[0]


def slope_of_erfcx(x: float) -> float:
    """-4 / sqrt(pi) times the integral of s exp(-s^2 - 2 x s) ds, in units of the width of the integrand."""
    width = 1.0 / (1.0 + max(x, 0.0))
    value = integrate.quad(
        lambda u: u * math.exp(-((u * width) ** 2) - 2.0 * x * u * width),
        0.0,
        40.0,
        epsabs=0.0,
        epsrel=1e-12,
        limit=200,
    )[0]
    return -4.0 / math.sqrt(math.pi) * value * width**2


def test_log_ratio_is_right_at_zero_and_its_derivative_too() -> None:
    values = [-1e6, -3.0, -0.1, -0.0999, -1e-9, 0.0, 1e-300, 1e-7, 0.0999, 0.1001, 0.5, 1.0 - 1e-9]
    y = tensor(values)
    ratio = log_ratio(y)
    expected = [unit_integral(lambda s, y=y: 1.0 / (1.0 - y * s)) for y in values[1:-1]]  # type: ignore[misc]
    np.testing.assert_allclose(ratio.detach().numpy()[1:-1], expected, rtol=1e-12)
    (slope,) = torch.autograd.grad(ratio.sum(), y)
    expected = [unit_integral(lambda s, y=y: s / (1.0 - y * s) ** 2) for y in values[1:-1]]  # type: ignore[misc]
    np.testing.assert_allclose(slope.numpy()[1:-1], expected, rtol=1e-11)
    assert log_ratio(tensor([1.0])).item() == math.inf


def test_scaled_erfc_keeps_the_digits_of_its_derivative_far_out() -> None:
    values = [-5.0, -0.3, 0.0, 1.0, 11.99, 12.01, 50.0, 1e7]
    x = tensor(values)
    value = scaled_erfc(x)
    np.testing.assert_allclose(value.detach().numpy(), special.erfcx(values), rtol=1e-14)
    (slope,) = torch.autograd.grad(value.sum(), x)
    # Integral representation: erfcx(x) = 2 / sqrt(pi) integral of exp(-s^2 - 2 x s) ds.
    expected = [slope_of_erfcx(x) for x in values]
    np.testing.assert_allclose(slope.numpy(), expected, rtol=1e-11)
    naive = 2.0 * values[-1] * special.erfcx(values[-1]) - 2.0 / math.sqrt(math.pi)
    assert abs(naive / expected[-1] - 1.0) > 1e-3


@pytest.mark.parametrize("function", [exponential_moment, log_ratio, scaled_erfc])
def test_single_precision_is_kept(function: object) -> None:
    x = torch.tensor([0.0, 1e-20, 0.3, 0.9])
    single, double = function(x), function(x.double())  # type: ignore[operator]
    assert single.dtype == torch.float32
    torch.testing.assert_close(single.double(), double, rtol=3e-7, atol=0.0)
