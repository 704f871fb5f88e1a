"""One group of extinction nodes of similar optical depth: its source points, passes of paths, smoothing and images.

A thin group needs few, widely spaced source points, since light varies over the whole cloud; a thick one needs points near the surface
that the camera sees, closer together than the mean free path allows anywhere else. So each group has its own lattice, its own marching
step and its own set of paths for all of its nodes.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from precompute.carried_orders import CarriedOrders, last_traced_orders
from precompute.error_budget import (
    GroupReport,
    StopReason,
    box_error,
    next_pass,
)
from precompute.error_probe import ErrorProbe, ImageErrors, SmoothSource
from precompute.gather import Lattice, Strata, gather_bags
from precompute.group_task import GroupTask
from precompute.heap import trim_heap
from precompute.light_lattice import number_points
from precompute.order_plan import SEPARATE_ORDERS, OrderPlan
from precompute.pilot import Pilot, fly_pilot
from precompute.single_scattering import compute_single_scattering
from precompute.smoothing import find_neighbours
from precompute.source_model import SourceModel, Surroundings, measure_surroundings
from precompute.source_points import SourceTable, allocate_paths, place_points
from precompute.view import View
from render.phase_functions import evaluate_phase_function

DARKEST = 0.2
"""Light at a point over its mean that paths are spent for at least."""

MATCHES = (0.5, 2.0)
"""Bounds of the factor on carried light: beyond them the paths are too few to tell it."""


@dataclass(frozen=True, eq=False)
class GroupImages:
    """Images of a group of extinctions for unit sunlight and albedo one.

    Args:
        single: `(extinction, pixel)`.
        multiple: `(knot, asymmetry, extinction, pixel)`.
        standard_error: relative RMS error of each image that was traced `(knot, asymmetry, extinction)`.
        image_error: of the composed image `(albedo, asymmetry, extinction)`.
        bright_error: the same at albedo one, with all orders `(asymmetry, extinction)`.
        effective_share: effective sample size over paths of each image that was traced `(knot, asymmetry, extinction)`.
        report: what was done.
    """

    single: Tensor
    multiple: Tensor
    standard_error: Tensor
    image_error: Tensor
    bright_error: Tensor
    effective_share: Tensor
    report: GroupReport


class _Clock:
    """Seconds by part, after each of which freed memory is given back."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._started = self._last = time.perf_counter()

    def lap(self, part: str) -> None:
        trim_heap()
        now = time.perf_counter()
        self.seconds[part] = self.seconds.get(part, 0.0) + now - self._last
        self._last = now

    @property
    def total(self) -> float:
        return time.perf_counter() - self._started


def build_group(task: GroupTask, report: Callable[[float], None]) -> GroupImages:
    """Images of a group; `report` is called with the share that is done."""
    clock, view = _Clock(), task.view
    strata = Strata.uncut(len(task.extinction), len(view.pixel), task.strata)
    rays, cut = (view.grid, view.origin, view.direction), partial(strata.cut, task.extinction)
    single, single_error = compute_single_scattering(*rays, view.sun, task.extinction, task.step, task.sections, cut)
    clock.lap("single scattering")
    report(0.1)
    pilot = fly_pilot(task, strata, single)
    clock.lap("pilot")
    phase = evaluate_phase_function(view.direction @ view.sun, task.asymmetry[:, None])
    if pilot.enough == 0:
        report(1.0)
        return _single_only(task, single, pilot.complete(torch.empty(0), phase[:, None] * single), pilot, clock)
    effort = pilot.suited(task.effort)
    points = task.points(effort)
    carried = _carry(task, pilot, points, report)
    plan = pilot.needed
    clock.lap("carried orders")
    lattice, importance = place_points(view, strata, points)
    clock.lap("source points")
    if carried is not None:
        _weigh_by_light(importance, lattice, carried)
    table = _path_table(task, lattice, plan, carried)
    table.add_pass(allocate_paths(importance, effort.first_paths), lambda share: report(0.2 + 0.1 * share))
    clock.lap("paths")
    entry = table.entry()
    once = (single, single_error)
    probe = ErrorProbe(view, lattice, entry, strata, once, task.asymmetry, plan, task.albedo, effort.tail)
    surroundings = measure_surroundings(view.grid, view.camera, view.sun, lattice.positions(table.numbers))
    clock.lap("source model")
    smoother = _Smoother(table, carried, probe, surroundings, task)
    gather = partial(_gather, view, lattice, entry, strata, smoother)
    multiple, errors, reason = _trace_until_accurate(task, table, importance, smoother, gather, clock, report)
    report(1.0)
    of_knots, image_error, bright_error = _stack_errors(errors)
    if reason is StopReason.PATHS and box_error(image_error) <= (effort.tolerance or 0.0):
        reason = StopReason.TOLERANCE
    return GroupImages(
        single,
        pilot.complete(multiple, phase[:, None] * single),
        of_knots,
        image_error,
        bright_error,
        _shares_of_all(table, plan),
        _describe(task, plan, pilot.omitted, table, carried, box_error(image_error), reason, clock),
    )


def _stack_errors(errors: list[ImageErrors]) -> tuple[Tensor, Tensor, Tensor]:
    """Errors of images and of composed images, as `GroupImages` has them."""
    of_knots = torch.stack([one.of_knots for one in errors], dim=2)
    of_image = torch.stack([one.of_image for one in errors], dim=2)
    of_bright = torch.stack([one.of_bright for one in errors], dim=1)
    return of_knots.float(), of_image.float(), of_bright.float()


def _carry(task: GroupTask, pilot: Pilot, points: int, report: Callable[[float], None]) -> CarriedOrders | None:
    """High orders, where they can be carried."""
    lattices = task.thick_lattices or task.lattices(pilot.needed.largest_order, points)
    if lattices is None:
        return None
    return task.carry(pilot.needed, lattices, points, lambda share: report(0.1 + 0.1 * share))


def _path_table(task: GroupTask, lattice: Lattice, plan: OrderPlan, carried: CarriedOrders | None) -> SourceTable:
    """Empty table of the orders that are not carried."""
    if carried is None:
        return task.source_table(lattice, plan, task.nodes(), 1)
    last_orders = partial(last_traced_orders, degree=carried.degree)
    last = min(int(last_orders(task.asymmetry).max()), plan.largest_order)
    return task.source_table(lattice, plan.until(last), task.nodes(last_orders), 1)


def _weigh_by_light(importance: Tensor, lattice: Lattice, carried: CarriedOrders) -> None:
    """Multiply the importance of points by the square of the light there, to which the deviation of its paths is about proportional."""
    used = torch.nonzero(importance).flatten()
    nodes, position = range(len(carried.features[0])), lattice.positions(used)
    light = torch.stack([carried.features_at(node, position) for node in nodes])
    light = light.clamp(min=0.0) / light.mean(1, keepdim=True).clamp(min=1e-30)
    importance[used] *= light.mean((0, 2)).clamp(min=DARKEST).double().square()


class _Smoother:
    """Smooths what a table of paths holds at the time, with the orders that were carried."""

    def __init__(
        self,
        table: SourceTable,
        carried: CarriedOrders | None,
        probe: ErrorProbe,
        surroundings: Surroundings,
        task: GroupTask,
    ) -> None:
        self._table, self._carried, self._probe = table, carried, probe
        self._surroundings, self._task = surroundings, task
        used = torch.zeros(table.lattice.size, dtype=torch.bool)
        used[table.numbers] = True
        self._points = number_points(table.lattice, used)

    def at(self, nodes: Iterable[int]) -> Iterator[SmoothSource]:
        """The source at some of the extinctions."""
        table = self._table
        neighbours = find_neighbours(table.lattice, table.numbers, table.paths)
        for node in nodes:
            source = of_paths = table.source[node]
            features = self._surroundings.features(float(self._task.extinction[node]))
            if self._carried is not None:
                position = table.lattice.positions(table.numbers)
                source = self._carried.at(node, position)
                if self._task.thick:
                    source *= self._match(self._carried, node, of_paths, position)
                if features.shape[1] > 1:
                    features = torch.cat([features, self._carried.features_at(node, position)], dim=1)
                source[:, :, : of_paths.shape[2]] += of_paths
            model = SourceModel(features, table.paths)
            smooth = self._probe.smooth(node, source, neighbours, model, self._points, self._task.thick)
            yield replace(smooth, errors=smooth.errors.times(self._task.unseen_error))
            trim_heap()

    def _match(self, carried: CarriedOrders, node: int, of_paths: Tensor, position: Tensor) -> Tensor:
        """Factor on carried light that lets it agree with the paths in the order four, which both know `(asymmetry,)`.

        Least squares over the pixels, as far as both halves of the paths say the same: what the lattice of carried light misses of
        that order in a thick cloud it misses of the next ones too. Where a forward lobe is not yet round at that order, and so does
        not show in harmonics, the factor is one.
        """
        round_by_then = last_traced_orders(self._task.asymmetry, carried.degree) == SEPARATE_ORDERS
        overlap = carried.overlap_at(node, position)[:, None].expand(-1, 2, -1)
        traced = of_paths[:, :, self._table.plan.knots.index(SEPARATE_ORDERS)]
        told, found = (self._probe.gather(node, one.contiguous()).double() for one in (overlap, traced))
        missing = (told * (found - told)).sum(0) / told.square().sum(0).clamp(min=1e-300)
        mean = missing.mean(0)
        agreement = (missing.prod(0) / mean.square().clamp(min=1e-300)).clamp(0.0, 1.0)
        return torch.where(round_by_then, (1.0 + agreement * mean).clamp(*MATCHES).float(), 1.0)


_Images = tuple[Tensor, list[ImageErrors]]
"""Smoothed images `(knot, asymmetry, extinction, pixel)`, and their errors at each extinction."""


def _trace_until_accurate(
    task: GroupTask,
    table: SourceTable,
    importance: Tensor,
    smoother: _Smoother,
    gather: Callable[[], _Images],
    clock: _Clock,
    report: Callable[[float], None],
) -> tuple[Tensor, list[ImageErrors], StopReason]:
    """Trace paths until the effort's tolerance is met or its limits are reached: images, their errors, and why no more were traced."""
    effort = task.effort
    while True:
        images: _Images | None = None
        done = int(table.paths.sum())
        reason = StopReason.FIXED if effort.tolerance is None else StopReason.PATHS
        if effort.tolerance is None or done >= effort.paths:
            break
        error, images = _error_so_far(smoother, gather, len(task.extinction), effort.tolerance)
        clock.lap("smoothing")
        following = next_pass(effort, done, error, clock.total, clock.seconds["paths"] / max(done, 1))
        if isinstance(following, StopReason):
            reason = following
            break
        share = done / (done + following)
        table.add_pass(
            allocate_paths(importance, following),
            lambda part, share=share: report(0.3 + 0.6 * (share + (1.0 - share) * part)),  # type: ignore[misc]
        )
        clock.lap("paths")
    multiple, errors = images or gather()
    clock.lap("images")
    return multiple, errors, reason


def _error_so_far(
    smoother: _Smoother, gather: Callable[[], _Images], extinctions: int, tolerance: float
) -> tuple[float, _Images | None]:
    """Error at every third extinction, which tells as well how many paths are missing; where none seem to be, at all, and the images."""
    error = _error_of(smooth.errors for smooth in smoother.at(range(extinctions - 1, -1, -3)))
    if error > tolerance:
        return error, None
    images = gather()
    return _error_of(images[1]), images


def _error_of(errors: Iterable[ImageErrors]) -> float:
    return box_error(torch.stack([one.of_image for one in errors]))


def _gather(view: View, lattice: Lattice, entry: Tensor, strata: Strata, smoother: _Smoother) -> _Images:
    """Images of what the smoother holds at the time."""
    images, errors = [], []
    for node, smooth in enumerate(smoother.at(range(len(strata.opacity)))):
        columns, shape = smooth.source.flatten(1), smooth.source.shape[1:]
        image = torch.empty(*shape, len(view.pixel))
        for bags in gather_bags(lattice, view.origin, view.direction, strata.at(node)):
            rows = embedding_bag(entry[bags.numbers], columns, per_sample_weights=bags.weights, mode="sum")
            # The model may fall below zero where it is dark.
            image[:, :, bags.rays] = rows.unflatten(1, shape).movedim(0, -1).clamp_(min=0.0)
        images.append(image)
        errors.append(smooth.errors)
    return torch.stack(images, dim=2), errors


def _single_only(task: GroupTask, single: Tensor, multiple: Tensor, pilot: Pilot, clock: _Clock) -> GroupImages:
    """A group whose multiple scattering is not traced."""
    nodes = (len(task.asymmetry), len(task.extinction))
    error = torch.full((len(task.albedo), *nodes), pilot.omitted)
    report = _describe(task, None, pilot.omitted, None, None, pilot.omitted, StopReason.SINGLE, clock)
    return GroupImages(single, multiple, torch.zeros(0, *nodes), error, error[0], torch.zeros(0, *nodes), report)


def _shares_of_all(table: SourceTable, plan: OrderPlan) -> Tensor:
    """Effective share of the paths for each image; one for those that no path adds to."""
    share = torch.where(table.effective_share > 0.0, table.effective_share, 1.0)
    return torch.cat([share, torch.ones(len(plan.knots) - len(share), *share.shape[1:])])


def _describe(
    task: GroupTask,
    plan: OrderPlan | None,
    omitted: float,
    table: SourceTable | None,
    carried: CarriedOrders | None,
    error: float,
    reason: StopReason,
    clock: _Clock,
) -> GroupReport:
    depth = task.extinction * task.view.largest_optical_length
    grid = task.view.grid
    return GroupReport(
        thinnest=float(depth[0]),
        thickest=float(depth[-1]),
        largest_order=1 if plan is None else plan.largest_order,
        omitted_share=omitted,
        points=0 if table is None else len(table.numbers),
        spacing=0.0 if table is None else float((table.lattice.spacing / grid.voxel_size).max()),
        paths=0 if table is None else int(table.paths.sum()),
        carried_points=0 if carried is None else carried.points,
        error=error,
        stop_reason=reason.value,
        seconds=clock.seconds,
    )
