"""Which scattering orders are traced, which share an image, and how many paths go on to the high ones.

Orders two, three and four have images of their own; the higher ones share those of the knots 6, 10, 18, 34, 66 whose distances
double, and 258 ... whose distances quadruple: so high an order counts in the brightest clouds only. An order k between the knots
a < k < b adds to both images with the weights for which

    w_a + w_b = 1    and    w_a q^a + w_b q^b = q^k,    q = 0.3^(1/a),

so that the sum over the knots of albedo^knot times image is exact for albedo one and for the albedo q at which the knot a has lost 70
per cent, and close in between. High orders are smooth and carry little: a part of the paths goes on past each knot, at a larger weight.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

SEPARATE_ORDERS = 4
"""Largest order that has an image of its own."""

FAR_ORDER = 66
"""From which on the distances of the knots quadruple."""

EXACT_SHARE = 0.3
"""albedo^a at the second albedo for which the sharing is exact."""

DENSE_ORDERS, CONNECTION = 6, 0.3
"""Up to this order every vertex is connected to the sun, then one in three: neighbours along a path know nearly the same."""

LARGEST_RATIO = 0.9999
"""Of two orders far up, beside the power of 3/2."""

CONTINUATION = 0.7
"""Share of the paths that goes on past a knot from the last separate order on."""


@dataclass(frozen=True, eq=False)
class OrderPlan:
    """Orders and their images.

    Args:
        knots: exponents of the albedo, one an image; the first is two, the last the largest order.
        shares: weight of each order's contribution to each knot's image `(order, knot)`, order two first.
        continuation: probability to go on to each order `(order,)`.
        connection: probability to connect a vertex of each order, and a branch, to the sun `(order,)`.
    """

    knots: tuple[int, ...]
    shares: Tensor
    continuation: Tensor
    connection: Tensor

    @property
    def largest_order(self) -> int:
        """Largest number of scatterings."""
        return self.knots[-1]

    def until(self, order: int) -> "OrderPlan":
        """The orders up to a knot."""
        return OrderPlan(
            tuple(knot for knot in self.knots if knot <= order),
            self.shares[: order - 1, : self.knots.index(order) + 1],
            self.continuation[: order - 1],
            self.connection[: order - 1],
        )


def place_knots(largest_order: int) -> list[int]:
    """Knots for all orders from two up to the largest."""
    knots = list(range(2, min(largest_order, SEPARATE_ORDERS) + 1))
    while knots[-1] < largest_order:
        growth = 2 if knots[-1] < FAR_ORDER else 4
        knots.append(min(growth * (knots[-1] - 2) + 2, largest_order))
    return knots


def plan_orders(largest_order: int) -> OrderPlan:
    """Plan for all orders from two up to the largest."""
    knots = place_knots(largest_order)
    orders = range(2, largest_order + 1)
    shares = torch.zeros(len(orders), len(knots), dtype=torch.float64)
    continuation = torch.ones(len(orders), dtype=torch.float64)
    for row, order in enumerate(orders):
        upper = next(number for number, knot in enumerate(knots) if knot >= order)
        if knots[upper] == order:
            shares[row, upper] = 1.0
        else:
            low, high = knots[upper - 1], knots[upper]
            q = EXACT_SHARE ** (1.0 / low)
            weight = (q**order - q**high) / (q**low - q**high)
            shares[row, upper - 1], shares[row, upper] = weight, 1.0 - weight
        if order - 1 >= SEPARATE_ORDERS and order - 1 in knots:
            continuation[row] = CONTINUATION
    connection = torch.tensor([1.0 if order <= DENSE_ORDERS else CONNECTION for order in orders], dtype=torch.float64)
    return OrderPlan(tuple(knots), shares, continuation, connection)


def close_tail(plan: OrderPlan, energy: Tensor) -> tuple[Tensor, Tensor]:
    """Decay of the orders beyond the largest, from the last two images under the assumption f_k ~ k^(-3/2) r^k.

    Light that is scattered often diffuses, and the number of scatterings after which it first comes out again falls with the power 3/2
    until the size of the cloud shows, then exponentially. The energies of the last two knots fix r; with it the largest order's own share
    f_K of its knot's image follows. `ScatteringStack` sums the series.

    Args:
        plan: with at least one image that is shared.
        energy: mean of each knot's image `(knot, ...)`.

    Returns:
        The ratio r in 0..0.9999 and the share f_K over the last image, each `(...)`; both zero where an energy is.
    """
    candidates = 1.0 - torch.logspace(0.0, math.log10(1.0 - LARGEST_RATIO), 2000, dtype=torch.float64)
    orders = torch.arange(2, plan.largest_order + 1, dtype=torch.float64)
    # Relative to the largest order, so that nothing underflows, and from a ratio on with which nothing overflows.
    smallest = max(1e-3, 10.0 ** (-300.0 / plan.largest_order))
    decay = candidates.clamp(min=smallest)[:, None] ** (orders - plan.largest_order)
    images = (decay * (orders / plan.largest_order) ** -1.5) @ plan.shares
    quotient = images[:, -1] / images[:, -2]
    last, before = energy[-1].double(), energy[-2].double()
    lit = (last > 0) & (before > 0)
    measured = torch.where(lit, last / before.clamp(min=1e-300), 0.0)
    place = torch.searchsorted(quotient, measured).clamp(max=len(candidates) - 1)
    ratio, share = candidates[place], 1.0 / images[place, -1]
    return torch.where(lit, ratio, 0.0), torch.where(lit, share, 0.0)
