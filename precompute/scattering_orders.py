"""Build the scattering stack: optical length, single scattering, and the orders from two upwards on the whole table.

The extinction nodes are treated in groups of similar optical depth, see `source_group`.
"""

from collections.abc import Callable
from dataclasses import asdict, replace

import torch
from torch import Tensor

from precompute.error_budget import ALBEDOS, Effort
from precompute.group_task import GroupTask
from precompute.order_plan import SEPARATE_ORDERS, close_tail, plan_orders
from precompute.source_group import GroupImages, build_group
from precompute.view import View, view_of
from render.camera import Camera
from render.density_grid import DensityGrid
from render.depth_nodes import SOFT_DEPTH
from render.errors import ParameterError
from render.phase_functions import check_asymmetry
from render.scattering_stack import ScatteringTables

Progress = Callable[[str, float], None]

GROUP_EDGES = (2.0, 20.0, 64.0, 128.0)
"""Largest optical depths at which a new group of extinction nodes begins."""

FEWEST_PATHS = 6
"""Of a group for each of the effort's source points, where a tolerance is asked for: halves of fewer hardly tell what smoothing changes."""

SCATTERED_DEPTH = 5.0
"""Largest optical depth beyond which nodes weigh about the same: thinner ones scatter less light more than once."""

DEEP_WEIGHT = 2.0
"""Of nodes beyond the last of them, where no lattice is fine enough to carry light and paths go on to the last order."""

DEFAULT_EFFORT = Effort()


def build_scattering_stack(
    grid: DensityGrid,
    camera: Camera,
    sun_direction: Tensor,
    asymmetry: Tensor,
    extinction: Tensor,
    effort: Effort = DEFAULT_EFFORT,
    seed: int = 0,
    on_progress: Progress = lambda stage, share: None,
    albedo: tuple[float, ...] = ALBEDOS,
) -> ScatteringTables:
    """Precompute the images of a cloud for every node of the (asymmetry x extinction) table.

    Args:
        grid: the volume.
        camera: the view.
        sun_direction: towards the sun `(3,)`, of any length.
        asymmetry: nodes `(asymmetry,)`, rising, within +-0.999.
        extinction: nodes `(extinction,)` [1/m], rising, positive.
        effort: work to spend, and the accepted error.
        seed: of all random streams.
        on_progress: called with a stage's name and the share of it that is done.
        albedo: at which errors are judged.

    Returns:
        The tables; for a view without cloud they have no pixel.

    Raises:
        ParameterError: for nodes outside their domain, or a sun vector without direction.
    """
    _check_nodes(asymmetry, extinction)
    view = view_of(grid, camera, sun_direction)
    optical_depth = extinction * view.largest_optical_length
    groups = _split_groups(optical_depth) if len(view.pixel) else []
    shares, parts = _path_shares(optical_depth, groups), list[GroupImages]()
    for number, group in enumerate(groups):
        name = f"optical depth {optical_depth[group][0]:.3g} to {optical_depth[group][-1]:.3g}"
        part_effort = _effort_of_group(effort, shares[number] / sum(shares[number:]), parts)
        task = GroupTask(view, asymmetry, extinction[group], torch.tensor(albedo), part_effort, seed * 64 + number)
        parts.append(build_group(task, _stage_reporter(on_progress, name)))
    return _assemble(view, asymmetry, extinction, effort, parts)


def _effort_of_group(effort: Effort, share: float, before: list[GroupImages]) -> Effort:
    """Effort of the next group: its share of what the groups before it, which are thinner, have left."""
    paths = effort.paths - sum(part.report.paths for part in before)
    seconds = sum(sum(part.report.seconds.values()) for part in before)
    # Once the time is up a group still gets its first pass.
    limit = None if effort.max_seconds is None else max(share * (effort.max_seconds - seconds), 1e-3)
    fewest = 1 if effort.tolerance is None else min(effort.paths, FEWEST_PATHS * effort.points)
    return replace(effort, paths=max(fewest, round(share * paths)), max_seconds=limit)


def _check_nodes(asymmetry: Tensor, extinction: Tensor) -> None:
    check_asymmetry(asymmetry)
    for name, nodes in (("asymmetry", asymmetry), ("extinction", extinction)):
        if nodes.ndim != 1 or len(nodes) == 0 or not bool((nodes.diff() > 0).all()):
            raise ParameterError(f"the {name} nodes must be one or more rising numbers, not {nodes.tolist()}")
    if not bool((extinction > 0).all() & torch.isfinite(extinction).all()):
        raise ParameterError(f"extinction nodes must be positive and finite, not {extinction.tolist()} 1/m")


def _stage_reporter(on_progress: Progress, name: str) -> Callable[[float], None]:
    """Progress of one stage that never falls, though a further pass of paths makes the whole larger."""
    largest = 0.0

    def report(share: float) -> None:
        nonlocal largest
        largest = max(largest, share)
        on_progress(name, largest)

    return report


def _split_groups(optical_depth: Tensor) -> list[slice]:
    edges = torch.tensor(GROUP_EDGES, dtype=optical_depth.dtype)
    number = torch.bucketize(optical_depth, edges, right=True)
    starts = [0] + [i for i in range(1, len(number)) if number[i] != number[i - 1]]
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(number)], strict=True)]


def _path_shares(optical_depth: Tensor, groups: list[slice]) -> list[float]:
    """Share of the paths for each group: by its number of nodes, how much light is scattered more than once, and how far it is followed."""
    weight = -torch.expm1(-optical_depth.double() / SCATTERED_DEPTH)
    weight = torch.where(optical_depth > GROUP_EDGES[-1], DEEP_WEIGHT * weight, weight)
    weights = [float(weight[group].sum()) for group in groups]
    return [weight / sum(weights) for weight in weights]


def _assemble(
    view: View, asymmetry: Tensor, extinction: Tensor, effort: Effort, parts: list[GroupImages]
) -> ScatteringTables:
    """Tables of all groups."""
    plan = plan_orders(effort.orders)
    knots, nodes, pixels = len(plan.knots), (len(asymmetry), len(extinction)), len(view.pixel)
    single, multiple = torch.zeros(len(extinction), pixels), torch.zeros(knots, *nodes, pixels)
    standard_error, share = torch.zeros(knots, *nodes), torch.ones(knots, *nodes)
    image_error, bright_error, ratio, last = (torch.zeros(nodes) for _ in range(4))
    start = 0
    for part in parts:
        group, traced = slice(start, start + len(part.single)), len(part.standard_error)
        single[group] = part.single
        multiple[:, :, group] = part.multiple
        standard_error[:traced, :, group], share[:traced, :, group] = part.standard_error, part.effective_share
        image_error[:, group] = part.image_error.square().mean(0).sqrt()
        bright_error[:, group] = part.bright_error
        start = group.stop
    if effort.tail and effort.orders > SEPARATE_ORDERS and pixels:
        # Sums in float32 are good to 1e-6; in float64 they would need a copy of the whole table.
        mean = multiple.sum(-1).double() / pixels
        ratio, last = (values.to(torch.float32) for values in close_tail(plan, mean))
    return ScatteringTables(
        width=view.camera.width,
        height=view.camera.height,
        pixel=view.pixel,
        optical_length=view.optical_length,
        cos_sun=view.direction @ view.sun,
        asymmetry=asymmetry,
        extinction=extinction,
        soft_extinction=torch.tensor(SOFT_DEPTH / (view.largest_optical_length or 1.0)),
        knots=torch.tensor(plan.knots),
        single=single,
        multiple=multiple,
        tail_ratio=ratio,
        tail_share=last,
        standard_error=standard_error,
        image_error=image_error,
        bright_error=bright_error,
        effective_share=share,
        groups=tuple(asdict(part.report) for part in parts),
    )
