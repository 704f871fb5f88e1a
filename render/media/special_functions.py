"""Functions that stay exact where the textbook form of a fog integral becomes 0/0, with derivatives that do so too.

    exponential_moment(x, n) = integral of s^n exp(-x s) ds from 0 to 1;    n = 0: (1 - exp(-x)) / x
    exponential_mean(a, b)   = (exp(-a) - exp(-b)) / (b - a), the mean of exp(-E) while E runs evenly from a to b
    log_ratio(y)             = -log(1 - y) / y
    scaled_erfc(x)           = exp(x^2) erfc(x)

Automatic differentiation of such quotients loses its digits near the removable singularity, although the values do
not (and that of erfcx loses them for large x). So the derivatives are analytic; those of the moments are moments
again, to any order.
"""

import math
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

SERIES_LIMIT, SERIES_TERMS = 1.0, 20
"""|x| below which moments above the zeroth are summed as Taylor series: the last term is below the rounding of float64."""

LOG_SERIES_LIMIT, LOG_SERIES_TERMS = 0.1, 18
"""The same for the derivative of `log_ratio`; at 0.1 its quotient has lost one digit."""

ASYMPTOTIC_LIMIT, ASYMPTOTIC_TERMS = 12.0, 12
"""x from which the asymptotic series of erfcx reaches the rounding of float64 long before it diverges."""


def exponential_moment(x: Tensor, power: int = 0) -> Tensor:
    """Moment of an exponential over the unit interval: integral of s^n exp(-x s) ds from 0 to 1.

    Args:
        x: rate [1], any sign and shape.
        power: n, not negative.

    Returns:
        The moment [1]; 1 / (n + 1) at x = 0. Differentiable to any order.
    """
    return _ExponentialMoment.apply(x, power)


def _moment(x: Tensor, power: int) -> Tensor:
    """Moment by quotient (n = 0), by the recurrence x m_n = n m_(n-1) - exp(-x), or by its Taylor series."""
    if power == 0:
        nonzero = torch.where(x == 0.0, 1.0, x)
        return torch.where(x == 0.0, 1.0, -torch.expm1(-nonzero) / nonzero)
    inside = x.abs() < SERIES_LIMIT
    far, near = torch.where(inside, 1.0, x), torch.where(inside, x, 0.0)
    decay, moment = torch.exp(-far), -torch.expm1(-far) / far
    for n in range(1, power + 1):
        moment = (n * moment - decay) / far
    series = torch.zeros_like(x)
    for j in reversed(range(SERIES_TERMS)):
        series = 1.0 / (math.factorial(j) * (power + 1 + j)) - near * series
    return torch.where(inside, series, moment)


class _ExponentialMoment(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, power: int) -> Tensor:
        ctx.save_for_backward(x)
        ctx.power = power
        return _moment(x, power)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        (x,) = ctx.saved_tensors
        return -gradients[0] * exponential_moment(x, ctx.power + 1), None


def exponential_mean(first: Tensor, last: Tensor) -> Tensor:
    """Mean of exp(-E) while the exponent E runs evenly from one value to the other.

        (exp(-a) - exp(-b)) / (b - a) = exp(-min(a, b)) m_0(|b - a|),   exp(-a) at a = b

    Args:
        first: a [1], not negative; may be infinite.
        last: b [1], not negative; may be infinite.

    Returns:
        The mean [1], 0 where either end is infinite.
    """
    first, last = torch.broadcast_tensors(first, last)
    dark = torch.isinf(first) | torch.isinf(last)
    a, b = torch.where(dark, 0.0, first), torch.where(dark, 0.0, last)
    return torch.where(dark, 0.0, torch.exp(-torch.minimum(a, b)) * exponential_moment((b - a).abs()))


def log_ratio(y: Tensor) -> Tensor:
    """-log(1 - y) / y, 1 at y = 0.

    Args:
        y: [1], at most 1.

    Returns:
        The ratio [1], infinite at y = 1. Differentiable once.
    """
    return _LogRatio.apply(y)


class _LogRatio(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, y: Tensor) -> Tensor:
        nonzero = torch.where(y == 0.0, 1.0, y)
        ratio = torch.where(y == 0.0, 1.0, -torch.log1p(-nonzero) / nonzero)
        ctx.save_for_backward(y, ratio)
        return ratio

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        y, ratio = ctx.saved_tensors
        inside = y.abs() < LOG_SERIES_LIMIT
        far, near = torch.where(inside, 0.5, y), torch.where(inside, y, 0.0)
        series = torch.zeros_like(y)
        for j in reversed(range(1, LOG_SERIES_TERMS)):
            series = j / (j + 1.0) + near * series
        return gradients[0] * torch.where(inside, series, (1.0 / (1.0 - far) - ratio) / far)


def scaled_erfc(x: Tensor) -> Tensor:
    """Scaled complementary error function exp(x^2) erfc(x), with the derivative -2 (1 / sqrt(pi) - x erfcx(x)).

    Args:
        x: [1], any shape; below about -26 the result is infinite in float64.

    Returns:
        erfcx(x) [1]. Differentiable once.
    """
    return _ScaledErfc.apply(x)


class _ScaledErfc(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        value = torch.special.erfcx(x)
        ctx.save_for_backward(x, value)
        return value

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        x, value = ctx.saved_tensors
        far = x > ASYMPTOTIC_LIMIT
        # sqrt(pi) x erfcx(x) = 1 - h + 3 h^2 - 15 h^3 + ... with h = 1 / (2 x^2) (DLMF 7.12.1); the ones cancel on paper.
        h = 0.5 / torch.where(far, x, 1.0).square()
        series = torch.zeros_like(x)
        for n in reversed(range(1, ASYMPTOTIC_TERMS)):
            series = 1.0 - (2 * n + 1) * h * series
        left = torch.where(far, h * series / math.sqrt(math.pi), 1.0 / math.sqrt(math.pi) - x * value)
        return -2.0 * gradients[0] * left
