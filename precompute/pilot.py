"""A few thousand paths that say how fast the orders of a group decay, and so which of them the tolerance needs."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from precompute.error_budget import OMITTED_SHARE, Effort
from precompute.error_probe import probe_rays
from precompute.gather import Strata, gather_bags
from precompute.group_task import GroupTask
from precompute.order_plan import OrderPlan, plan_orders
from precompute.source_points import allocate_paths, place_points
from render.phase_functions import evaluate_phase_function

FAINT_SHARE, FAINT_EFFORT = 5.0, 0.1
"""Multiple scattering below so many times the tolerance gets a tenth of the points and paths; the error is estimated as ever."""

PILOT_POINTS, PILOT_PATHS = 2000, 32_000
"""Source points and paths of the pilot that says how fast the orders decay."""


@dataclass(frozen=True, eq=False)
class Pilot:
    """How the orders decay, from few paths.

    Args:
        plan: all orders that may be traced.
        enough: number of images that the tolerance needs; zero where single scattering is enough.
        omitted: share of the mean image that the others have, at the node where it is largest.
        multiple: share that all of them have, likewise.
        mean: of every image over the pixels `(knot, asymmetry, extinction)`; none without a tolerance.
    """

    plan: OrderPlan
    enough: int
    omitted: float
    multiple: float
    mean: Tensor | None

    @property
    def needed(self) -> OrderPlan:
        """The orders that are traced."""
        return plan_orders(self.plan.knots[self.enough - 1])

    @classmethod
    def of_all_orders(cls, orders: int) -> "Pilot":
        """The pilot of a group that has all orders anyway."""
        plan = plan_orders(orders)
        return cls(plan, len(plan.knots), 0.0, 1.0, None)

    def suited(self, effort: Effort) -> Effort:
        """The effort that the group's multiple scattering is worth."""
        if effort.tolerance is None or self.multiple > FAINT_SHARE * effort.tolerance:
            return effort
        return replace(
            effort,
            points=max(PILOT_POINTS, round(FAINT_EFFORT * effort.points)),
            paths=max(PILOT_PATHS, round(FAINT_EFFORT * effort.paths)),
        )

    def complete(self, multiple: Tensor, shape: Tensor) -> Tensor:
        """Images of all knots: those that were not traced have the pilot's mean and the shape of the last one that was.

        They are too faint to matter by themselves, but without them the interpolation between nodes would meet a cliff.

        Args:
            multiple: images that were traced `(knot, asymmetry, extinction, pixel)`.
            shape: image to use where none was `(asymmetry, extinction, pixel)`.
        """
        if self.mean is None or len(multiple) == len(self.mean):
            return multiple
        known = len(multiple)
        last = multiple[-1] if known else shape
        relative = last / last.mean(-1, keepdim=True).clamp(min=1e-30)
        return torch.cat([multiple, self.mean[known:, ..., None].to(torch.float32) * relative])


def fly_pilot(task: GroupTask, strata: Strata, single: Tensor) -> Pilot:
    """Find out which orders the tolerance needs.

    In a thick group that carries light all orders come with those that are needed. The pilot's own mean of them would be noise, and images
    between its thickest node and the next group's, which may need them, hang on both.
    """
    if task.effort.tolerance is None or task.thick_lattices is not None:
        return Pilot.of_all_orders(task.effort.orders)
    plan = plan_orders(task.effort.orders)
    rays = probe_rays(len(task.view.pixel))
    view, part = task.view.part(rays), strata.part(rays)
    lattice, importance = place_points(view, part, PILOT_POINTS)
    table = task.source_table(lattice, plan, task.nodes(), 0)
    table.add_pass(allocate_paths(importance, PILOT_PATHS))
    entry = table.entry()
    mean = torch.zeros(len(plan.knots), len(task.asymmetry), len(task.extinction), dtype=torch.float64)
    for bags in gather_bags(lattice, view.origin, view.direction, part):
        columns = table.source[bags.extinction].mean(1).flatten(1)
        rows = embedding_bag(entry[bags.numbers], columns, per_sample_weights=bags.weights, mode="sum")
        mean[:, :, bags.extinction] += rows.double().sum(0).unflatten(0, (len(plan.knots), -1)) / len(rays)
    phase = evaluate_phase_function(view.direction @ view.sun, task.asymmetry[:, None]).double()
    lit = phase @ single[:, rays].double().T / len(rays)
    knots = torch.tensor(plan.knots)
    judged = _shares_beyond(float(task.albedo.max()), lit, mean, knots)
    bright = _shares_beyond(1.0, lit, mean, knots)
    small = (judged <= OMITTED_SHARE * task.effort.tolerance) & (bright <= task.effort.tolerance)
    enough = int(small.nonzero()[0])
    return Pilot(plan, enough, float(judged[enough]), float(judged[0]), mean)


def _shares_beyond(albedo: float, single: Tensor, mean: Tensor, knots: Tensor) -> Tensor:
    """Share of the light that the images from each on hold, at the node where it is largest `(knot + 1,)`.

    Args:
        albedo: of the cloud.
        single: mean of single scattering at albedo one `(asymmetry, extinction)`.
        mean: of every image `(knot, asymmetry, extinction)`.
        knots: exponents of the albedo.
    """
    energy = (albedo ** knots.double())[:, None, None] * mean
    beyond = torch.cat([energy.flip(0).cumsum(0).flip(0), torch.zeros_like(single)[None]])
    return (beyond / (albedo * single + energy.sum(0)).clamp(min=1e-300)).flatten(1).amax(1)
