"""Which lattice points carry the in-scattered source, how many paths each deserves, and the source at them.

The variance of a pixel is a sum over points of weight^2 variance / paths, so the best allocation of a given number of paths is
proportional to the root of the summed squared weights (Neyman 1934). Counts are rounded to powers of two, in two halves whose difference
estimates the error.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from precompute.gather import Lattice, Strata, gather_bags, lattice_over
from precompute.order_plan import OrderPlan
from precompute.path_sampler import TableNodes, sample_paths
from precompute.view import View
from render.camera import Camera
from render.density_grid import DensityGrid
from render.free_flight import DARKEST_DEPTH
from render.fused import fused_loops_wanted
from render.random_streams import counter_keys, stream_number

SMALLEST_BATCH = 4
LARGEST_BATCH = 4096
"""Paths a point in one pass; both powers of two, at least two for each half."""

PATHS_PER_POINT = 1 << 20
"""Numbers that the paths of a point may have, over all passes."""

LANES = 1 << 15
"""Paths in flight at once; bounds the memory."""

THICK_SPACING = 0.5
"""Closest lattice in voxels: pixels and density vary over a voxel, not over less."""

LARGEST_LATTICE = 1 << 24
"""Lattice points that may be numbered, whether or not they are used."""


@dataclass(frozen=True, eq=False)
class SourcePoints:
    """Points and their number of paths.

    Args:
        numbers: of the lattice points that some pixel uses `(point,)`.
        paths: of each point `(point,)`, powers of two.
    """

    numbers: Tensor
    paths: Tensor


def place_points(view: View, strata: Strata, points: int) -> tuple[Lattice, Tensor]:
    """Lattice as fine as the number of points allows, and the importance of each of its points: summed squared weights."""
    finest = max(THICK_SPACING, (view.grid.density.numel() / LARGEST_LATTICE) ** (1.0 / 3.0))
    stretch = max(finest, 1.0)
    for _ in range(4):
        lattice = lattice_over(view.grid, stretch)
        importance = torch.zeros(lattice.size, dtype=torch.float64)
        for bags in gather_bags(lattice, view.origin, view.direction, strata):
            importance.index_add_(0, bags.numbers.flatten(), bags.weights.flatten().double().square())
        used = int((importance > 0).sum())
        wanted = max(finest, stretch * (used / points) ** 0.4)
        if 0.96 < wanted / stretch < 1.04:
            break
        stretch = wanted
    return lattice, importance


def allocate_paths(importance: Tensor, paths: int) -> SourcePoints:
    """Distribute paths over lattice points.

    Args:
        importance: summed squared weights of every lattice point `(point,)`.
        paths: wanted in all; rounding to powers of two moves the sum by up to a factor of sqrt(2).
    """
    numbers = torch.nonzero(importance > 0).flatten()
    root = importance[numbers].double().sqrt()
    scale = paths / float(root.sum().clamp(min=1e-300))
    for _ in range(8):
        counts = torch.exp2(torch.log2((root * scale).clamp(SMALLEST_BATCH, LARGEST_BATCH)).round())
        scale *= paths / max(float(counts.sum()), 1.0)
    return SourcePoints(numbers, counts.long())


class SourceTable:
    """In-scattered radiance towards the camera at source points, better with every pass.

    A path's random numbers depend on the seed, its point's place in the lattice and its own number only.

    Args:
        grid: the volume.
        camera: gives the direction of travel at each point.
        sun_direction: unit vector towards the sun `(3,)`.
        lattice: of the points.
        nodes: of the table.
        plan: orders and their images.
        step: longest marching step in voxels.
        seed: of the random streams.

    Attributes:
        numbers: of the points in the lattice `(point,)`.
        paths: traced from each `(point,)`.
        source: J `(extinction, point, half, knot, asymmetry)` [1/sr], for unit sunlight and albedo one.
    """

    def __init__(
        self,
        grid: DensityGrid,
        camera: Camera,
        sun_direction: Tensor,
        lattice: Lattice,
        nodes: TableNodes,
        plan: OrderPlan,
        step: float,
        seed: int,
    ) -> None:
        self.grid, self.camera, self.sun_direction, self.lattice = grid, camera, sun_direction, lattice
        self.nodes, self.plan, self.step = nodes, plan, step
        self._stream = stream_number(seed)
        self.numbers, self.paths = torch.empty(0, dtype=torch.long), torch.empty(0, dtype=torch.long)
        shape = (len(plan.knots), len(nodes.asymmetry), len(nodes.extinction))
        self.source = torch.empty(shape[2], 0, 2, *shape[:2])
        self._sums = torch.zeros(shape, dtype=torch.float64)
        self._squares = torch.zeros(shape, dtype=torch.float64)

    def add_pass(self, points: SourcePoints, on_progress: Callable[[float], None] = lambda share: None) -> None:
        """Trace more paths from the points, always the same ones.

        Args:
            points: numbers and path counts.
            on_progress: called with the share of paths done.
        """
        if len(self.paths) == 0:
            self.numbers, self.paths = points.numbers, torch.zeros_like(points.paths)
            self.source = self.source.new_zeros(len(self.source), len(self.numbers), *self.source.shape[2:])
        trace = _trace_batch_fused if fused_loops_wanted(self.grid.density) else _trace_batch
        done, total = 0, int(points.paths.sum())
        for count in points.paths.unique().tolist():
            members = torch.nonzero(points.paths == count).flatten()
            for part in members.split(max(1, LANES // count)):
                position = self.lattice.positions(self.numbers[part])
                counters = PATHS_PER_POINT * self.numbers[part] + self.paths[part]
                batch = _Batch(position, self.camera.directions_at(position), count, counters)
                means, squares = trace(
                    self.grid, self.sun_direction, batch, self.nodes, self.plan, self.step, self._stream
                )
                share = (count / (self.paths[part] + count).float())[:, None, None, None]
                self.source[:, part] = torch.lerp(self.source[:, part], means, share)
                self._sums += count * means.double().mean(2).square().sum(1).permute(1, 2, 0)
                self._squares += squares
                done += count * len(part)
                on_progress(done / total)
        self.paths = self.paths + points.paths

    def entry(self) -> Tensor:
        """Number of each lattice point among the points `(lattice point,)` int32; zero for those that are none."""
        entry = torch.zeros(self.lattice.size, dtype=torch.int32)
        entry[self.numbers] = torch.arange(len(self.numbers), dtype=torch.int32)
        return entry

    @property
    def effective_share(self) -> Tensor:
        """Effective sample size over number of paths per node `(knot, asymmetry, extinction)`, averaged over passes."""
        # Vertices of one path may share an image, which makes its sum more even than their squares say.
        return (self._sums / self._squares.clamp(min=1e-300)).clamp(max=1.0).to(torch.float32)


@dataclass(frozen=True, eq=False)
class _Batch:
    """Points with equally many paths: places, camera directions there, paths of each, number of the first path."""

    position: Tensor
    direction: Tensor
    count: int
    counters: Tensor


def _trace_batch(
    grid: DensityGrid,
    sun_direction: Tensor,
    batch: _Batch,
    nodes: TableNodes,
    plan: OrderPlan,
    step: float,
    stream: int,
) -> tuple[Tensor, Tensor]:
    """Mean weights `(extinction, point, half, knot, asymmetry)` and their summed squares `(knot, asymmetry, extinction)`."""
    points, count = len(batch.position), batch.count
    start, direction = (vectors.repeat_interleave(count, dim=0) for vectors in (batch.position, batch.direction))
    keys = counter_keys(stream, (batch.counters[:, None] + torch.arange(count)).flatten())
    shape = (len(nodes.asymmetry), len(nodes.extinction))
    means = torch.zeros(points, 2, len(plan.knots), *shape, dtype=torch.float64)
    squares = torch.zeros(len(plan.knots), *shape, dtype=torch.float64)
    for vertex in sample_paths(grid, start, direction, sun_direction, nodes, plan, step, keys):
        of_asymmetry, of_extinction = vertex.asymmetry_factor.double(), vertex.extinction_factor.double()
        of_all_asymmetry = of_asymmetry.new_zeros(points * count, shape[0]).index_copy_(0, vertex.path, of_asymmetry)
        of_all_extinction = of_asymmetry.new_zeros(points * count, shape[1]).index_copy_(0, vertex.path, of_extinction)
        halves = of_all_asymmetry.reshape(points * 2, count // 2, -1).transpose(1, 2)
        sums = (halves @ of_all_extinction.reshape(points * 2, count // 2, -1)).unflatten(0, (points, 2))
        products = of_asymmetry.square().T @ of_extinction.square()
        for knot, share in enumerate(plan.shares[vertex.order - 2].tolist()):
            if share:
                means[:, :, knot] += (share * 2.0 / count) * sums
                squares[knot] += share * share * products
    return means.permute(4, 0, 1, 2, 3).to(torch.float32), squares


def _trace_batch_fused(
    grid: DensityGrid,
    sun_direction: Tensor,
    batch: _Batch,
    nodes: TableNodes,
    plan: OrderPlan,
    step: float,
    stream: int,
) -> tuple[Tensor, Tensor]:
    """The same in one fused loop."""
    from precompute.fused_paths import trace_paths  # needs numba

    return trace_paths(
        grid.table.padded,
        grid.table.clearance,
        torch.stack([grid.lower, grid.upper, grid.voxel_size]),
        step * float(grid.voxel_size.min()),
        DARKEST_DEPTH / float(nodes.extinction[0]),
        batch.position,
        batch.direction,
        sun_direction,
        torch.full((len(batch.position),), batch.count),
        batch.counters,
        nodes.asymmetry,
        nodes.asymmetry_anchors,
        nodes.asymmetry_odds,
        nodes.last_order(nodes.asymmetry),
        nodes.last_order(nodes.asymmetry_anchors),
        nodes.extinction,
        nodes.extinction_anchors,
        plan.continuation,
        plan.connection,
        plan.shares,
        stream,
    )
