"""Clouds whose high orders are carried: plans with an image of every order, and pixels of what was carried."""

import torch
from torch import Tensor

from precompute.carried_orders import CarriedOrders
from precompute.order_plan import OrderPlan
from precompute.view import View
from tests.support.rays import stratify_rays


def plan_every_order(largest: int) -> OrderPlan:
    """All orders from two up to the largest, each with an image of its own."""
    ones = torch.ones(largest - 1, dtype=torch.float64)
    return OrderPlan(tuple(range(2, largest + 1)), torch.eye(largest - 1, dtype=torch.float64), ones, ones)


def render_carried(carried: CarriedOrders, view: View, extinction: Tensor, node: int, strata: int = 48) -> Tensor:
    """Radiance of the carried orders at one extinction [1/m] of the table, summed over the knots: `(half, ray, asymmetry)` [1/sr]."""
    rays = stratify_rays(view.grid, view.origin, view.direction, extinction[node : node + 1], strata)
    places = view.origin[:, None] + rays.distance[0, ..., None] * view.direction[:, None]
    source = carried.at(node, places.flatten(0, 1)).sum(2).unflatten(0, (-1, strata))
    return (source.mean(1) * rays.opacity[0, :, None, None]).movedim(1, 0)
