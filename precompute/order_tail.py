"""Orders of scattering beyond the last that was carried, from how those before it followed from each other.

Each order is the same linear map of the one before, so its images are sums of powers of that map's eigenvalues, and images a stride apart
obey a linear recurrence v_k = c_1 v_(k-s) + ... + c_p v_(k-ps) as far as p eigenvalues matter. Its coefficients are fitted to what was
carried, over all points at once, which tells slow modes from fast ones by where they shine. This is Prony's method for vectors, or
dynamic mode decomposition with delays (Tu et al. 2014, "On dynamic mode decomposition: theory and applications"). A single ratio
takes the light of the sunlit side for that of the whole cloud: seen against the sun at optical depth 57 and albedo one, the image
came out 3 per cent dark, now 1.
"""

import torch
from torch import Tensor

from precompute.order_plan import LARGEST_RATIO

STRIDE, LAGS = 4, 6
"""Of the recurrence. Neighbouring orders are too alike to be told apart; a stride of eight, after which the sets of directions that orders
take turns with come back, errs more: of all carried light in the Disney cloud, depth 60 and albedo one, by 7 instead of 5 per cent."""

FIT_STEP = 2
"""Between the orders that it is fitted to."""

RIDGE = 1e-9
"""Added to the normal equations, relative to their diagonal."""

HISTORY = STRIDE * LAGS + 12
"""Orders that are looked back at."""


def extrapolate_orders(history: list[Tensor], shares: Tensor) -> Tensor:
    """Sum over further orders of their shares times their values.

    Args:
        history: values of consecutive orders, the last ones that are known `(point, column)`; each column has a recurrence of its own.
        shares: of the orders that follow `(order, sum)`.

    Returns:
        The sums `(sum, point, column)`.
    """
    sums = history[0].new_zeros(shares.shape[1], *history[0].shape)
    for column in range(history[0].shape[1]):
        values = torch.stack([order[:, column] for order in history])
        weights = _weights_of_known(_fit_recurrence(values), len(values), shares.double())
        sums[:, :, column] = weights.T.to(values) @ values
    return sums


def _fit_recurrence(values: Tensor) -> Tensor:
    """Coefficients `(lag,)` for values `(order, point)`: as many as do not let the light grow, perhaps none."""
    count = len(values)
    wide = values.double()
    products = wide @ wide.T
    for lags in range(min(LAGS, (count - 1) // STRIDE), 0, -1):
        fitted = range(count - 1, lags * STRIDE - 1, -FIT_STEP)
        normal, moment = products.new_zeros(lags, lags), products.new_zeros(lags)
        for order in fitted:
            before = [order - STRIDE * lag for lag in range(1, lags + 1)]
            weight = 1.0 / products[order, order].clamp(min=1e-300)
            normal += weight * products[before][:, before]
            moment += weight * products[before, order]
        normal.diagonal().mul_(1.0 + RIDGE)
        factor, failed = torch.linalg.cholesky_ex(normal)
        if failed:
            continue
        found = torch.cholesky_solve(moment[:, None], factor)[:, 0]
        if float(torch.linalg.eigvals(_companion(found)).abs().max()) <= LARGEST_RATIO**STRIDE:
            return found
    return products.new_zeros(0)


def _companion(coefficients: Tensor) -> Tensor:
    """Matrix whose eigenvalues are the roots of the recurrence."""
    lags = len(coefficients)
    below = torch.eye(lags - 1, lags, dtype=coefficients.dtype)
    return torch.cat([coefficients[None], below])


def _weights_of_known(coefficients: Tensor, count: int, shares: Tensor) -> Tensor:
    """Weights `(known order, sum)` of the known orders in the sums over those that follow."""
    weights = shares.new_zeros(count, shares.shape[1])
    lags = len(coefficients)
    if lags == 0:
        return weights
    step = _companion(coefficients)
    for residue in range(STRIDE):
        # The known orders of this residue, the last one first, and what the one after m strides is made of.
        base = [count - 1 - residue - STRIDE * lag for lag in range(lags)]
        row = torch.eye(lags, dtype=shares.dtype)[0]
        for order in range(STRIDE - residue, len(shares) + 1, STRIDE):
            row = row @ step
            weights[base] += row[:, None] * shares[order - 1]
    return weights
