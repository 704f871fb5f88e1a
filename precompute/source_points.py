"""Which lattice points carry the in-scattered source, how many paths each deserves, and the source at them.

The variance of a pixel is a sum over points of weight^2 variance / paths, so the best allocation of a given number of paths is
proportional to the root of the summed squared weights (Neyman 1934). Counts are rounded to powers of two, in two halves whose difference
estimates the error.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from precompute.gather import Lattice
from precompute.path_sampler import TableNodes, sample_paths
from render.camera import Camera
from render.density_grid import DensityGrid
from render.random_streams import child_generator

SMALLEST_BATCH = 4
LARGEST_BATCH = 256
"""Paths a point; both powers of two, at least two for each half."""

LANES = 1 << 15
"""Paths in flight at once. Part of the result's definition (one random stream per batch), hence not a parameter."""


@dataclass(frozen=True, eq=False)
class SourcePoints:
    """Points and their number of paths.

    Args:
        numbers: of the lattice points that some pixel uses `(point,)`.
        paths: of each point `(point,)`, powers of two.
    """

    numbers: Tensor
    paths: Tensor


@dataclass(frozen=True, eq=False)
class SourceTable:
    """In-scattered radiance towards the camera at the points, from two independent halves of the paths.

    Args:
        source: J `(extinction, point, half, order, asymmetry)` [1/sr], for unit sunlight and albedo one, order two first.
        effective_share: effective sample size over number of paths per node `(order, asymmetry, extinction)`.
        paths: traced in all.
    """

    source: Tensor
    effective_share: Tensor
    paths: int


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


def trace_source(
    grid: DensityGrid,
    camera: Camera,
    sun_direction: Tensor,
    lattice: Lattice,
    points: SourcePoints,
    nodes: TableNodes,
    orders: int,
    step: float,
    seed: int,
    on_progress: Callable[[float], None] = lambda share: None,
) -> SourceTable:
    """Path trace the source at every point.

    Args:
        grid: the volume.
        camera: gives the direction of travel at each point.
        sun_direction: unit vector towards the sun `(3,)`.
        lattice: of the points.
        points: numbers and path counts.
        nodes: of the table.
        orders: largest number of scatterings, at least two.
        step: longest marching step in voxels.
        seed: of the random streams.
        on_progress: called with the share of paths done.
    """
    shape = (len(nodes.extinction), len(points.numbers), 2, orders - 1, len(nodes.asymmetry))
    source = torch.zeros(shape)
    totals = _NodeTotals(orders - 1, nodes)
    done, total = 0, int(points.paths.sum())
    for count in points.paths.unique().tolist():
        members = torch.nonzero(points.paths == count).flatten()
        for batch, part in enumerate(members.split(LANES // count)):
            generator = child_generator(seed, count, batch)
            position = lattice.positions(points.numbers[part])
            sums = _trace_batch(grid, camera, sun_direction, position, count, nodes, orders, step, generator, totals)
            source[:, part] = sums.permute(4, 0, 1, 2, 3).to(torch.float32)
            done += count * len(part)
            on_progress(done / total)
    return SourceTable(source, totals.effective_share(), total)


class _NodeTotals:
    """Sums over points of (sum of weights)^2 / paths and of the squared weights, per node."""

    def __init__(self, orders: int, nodes: TableNodes) -> None:
        self.of_sums = torch.zeros(orders, len(nodes.asymmetry), len(nodes.extinction), dtype=torch.float64)
        self.of_squares = torch.zeros_like(self.of_sums)

    def effective_share(self) -> Tensor:
        return (self.of_sums / self.of_squares.clamp(min=1e-300)).to(torch.float32)


def _trace_batch(
    grid: DensityGrid,
    camera: Camera,
    sun_direction: Tensor,
    position: Tensor,
    count: int,
    nodes: TableNodes,
    orders: int,
    step: float,
    generator: torch.Generator,
    totals: _NodeTotals,
) -> Tensor:
    """Mean weights `(point, half, order, asymmetry, extinction)` of `count` paths from each of a few points."""
    points = len(position)
    start = position.repeat_interleave(count, dim=0)
    direction = camera.directions_at(position).repeat_interleave(count, dim=0)
    means = torch.zeros(points, 2, orders - 1, len(nodes.asymmetry), len(nodes.extinction), dtype=torch.float64)
    for vertex in sample_paths(grid, start, direction, sun_direction, nodes, orders, step, generator):
        of_asymmetry = torch.zeros(points * count, len(nodes.asymmetry), dtype=torch.float64)
        of_extinction = torch.zeros(points * count, len(nodes.extinction), dtype=torch.float64)
        of_asymmetry[vertex.path] = vertex.asymmetry_factor.double()
        of_extinction[vertex.path] = vertex.extinction_factor.double()
        halves = of_asymmetry.reshape(points * 2, count // 2, -1).transpose(1, 2)
        sums = halves @ of_extinction.reshape(points * 2, count // 2, -1)
        sums = sums.reshape(points, 2, len(nodes.asymmetry), len(nodes.extinction))
        means[:, :, vertex.order - 2] = sums * (2.0 / count)
        totals.of_sums[vertex.order - 2] += sums.sum(1).square().sum(0) / count
        totals.of_squares[vertex.order - 2] += of_asymmetry.square().T @ of_extinction.square()
    return means
