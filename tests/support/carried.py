"""Clouds whose high orders are carried: plans with an image of every order, and pixels of what was carried."""

from functools import cache

import torch
from torch import Tensor

from precompute.carried_orders import CarriedOrders
from precompute.order_plan import OrderPlan
from precompute.view import View, view_of
from render.camera import OrthographicCamera
from render.procedural_cloud import build_cumulus
from tests.support.rays import stratify_rays
from tests.support.volumes import towards

SUN = towards(140.0, 35.0)


@cache
def cloud_view() -> View:
    """A cumulus with little room around it."""
    grid = build_cumulus(24, seed=3)
    centre, radius = grid.centre, grid.radius
    eye = (float(centre[0]), float(centre[1]) - 4.0 * radius, float(centre[2]))
    target = (float(centre[0]), float(centre[1]), float(centre[2]))
    return view_of(grid, OrthographicCamera(eye, target, 1.2 * radius, 8, 8), SUN)


def both_halves(carried: CarriedOrders) -> torch.Tensor:
    """The source of halves with one lattice `(extinction, half, point, knot, asymmetry)`."""
    return torch.stack(carried.source, dim=1)


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
