"""Fused twin of `path_sampler` and of the sums over its paths; imported only where numba is installed.

One path is followed from its start to its end before the next begins, with the same random numbers as in the torch code. Products of
phase functions are kept as numbers instead of logarithms, scaled after each scattering by the largest density.
"""

import math

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from precompute.path_sampler import ASYMMETRY_DRAW, EXTINCTION_DRAW, Draw
from render.fused import announce_compilation, run_in_threads
from render.fused_flight import Bytes, fly
from render.fused_scattering import (
    GOLDEN,
    Doubles,
    Floats,
    Vector,
    cosine_between,
    mix,
    phase,
    turn,
    uniform,
)

CHUNK = 64
"""Points whose paths are traced by one call."""

Medium = tuple[Floats, Bytes, Floats, float, float]
"""Densities; clearance of their cells; corners and voxel size of their box; marching step; farthest optical length to the sun."""
Longs = NDArray[np.int64]
Table = tuple[Floats, Floats, Doubles, Longs, Longs, Doubles, Doubles]
"""Asymmetries, their anchors and the odds of these; last order of asymmetries and anchors; extinctions and their anchors, each with the
logarithms as a second row."""
Plan = tuple[Doubles, Doubles, Doubles]
"""Continuation, connection and shares of an `OrderPlan`."""
Points = tuple[Floats, Floats, Floats, NDArray[np.int64], NDArray[np.int64]]
"""Positions, directions, the sun's direction, numbers of paths, numbers of the first paths."""
Sums = tuple[Doubles, Doubles, Doubles, Doubles, Doubles, Doubles]
"""Sums and squares of the weights, and space for products, densities and the two factors of a vertex."""

CONTINUATION, COSINE, AZIMUTH, FLIGHT, CONNECTION = (int(draw) for draw in list(Draw)[:5])
BRANCH, BRANCH_COSINE, BRANCH_AZIMUTH, BRANCH_FLIGHT = (int(draw) for draw in list(Draw)[5:])
DRAWS = len(Draw)


@njit(nogil=True, cache=True)
def _choose(number: float, odds: Doubles) -> int:
    """Number of an anchor; the odds sum to one."""
    reached = 0.0
    for anchor in range(len(odds) - 1):
        reached += odds[anchor]
        if number < reached:
            return anchor
    return len(odds) - 1


@njit(nogil=True, cache=True)
def _sampled(
    order: int, cosine: float, cosine_sun: float, anchors: Floats, odds: Doubles, last: Longs, density: Doubles
) -> float:
    """Density of all anchors with which a leg or a branch takes a direction, after the legs before it."""
    mean = 0.0
    for a in range(len(anchors)):
        if last[a] < order:
            continue
        branch = anchors[a] * anchors[a] * phase(cosine_sun, anchors[a])
        mean += odds[a] * density[a] * (phase(cosine, anchors[a]) + branch)
    return mean


@njit(nogil=True, cache=True)
def _scatter(cosine: float, nodes: Floats, anchors: Floats, product: Doubles, density: Doubles) -> None:
    """Multiply one scattering into the products, all scaled by the largest density."""
    largest = 0.0
    for a in range(len(anchors)):
        density[a] *= phase(cosine, anchors[a])
        largest = max(largest, density[a])
    scale = 1.0 / largest
    for a in range(len(anchors)):
        density[a] *= scale
    for g in range(len(nodes)):
        product[g] *= phase(cosine, nodes[g]) * scale


@njit(nogil=True, cache=True)
def _connect(order: int, passed: float, sun_length: float, nodes: Doubles, anchors: Doubles, factor: Doubles) -> None:
    """S of a vertex at each extinction; row 0 of nodes and anchors holds the extinctions, row 1 their logarithms."""
    largest = -np.inf
    for b in range(anchors.shape[1]):
        largest = max(largest, (order - 1) * anchors[1, b] - anchors[0, b] * passed)
    mean = 0.0
    for b in range(anchors.shape[1]):
        mean += math.exp((order - 1) * anchors[1, b] - anchors[0, b] * passed - largest)
    for s in range(nodes.shape[1]):
        exponent = (order - 1) * nodes[1, s] - nodes[0, s] * (passed + sun_length)
        factor[s] = math.exp(exponent - largest) * anchors.shape[1] / mean


@njit(nogil=True, cache=True)
def _deposit(share: float, of_g: Doubles, of_s: Doubles, sums: Doubles, squares: Doubles) -> None:
    for g in range(len(of_g)):
        weight = share * of_g[g]
        for s in range(len(of_s)):
            value = weight * of_s[s]
            sums[g, s] += value
            squares[g, s] += value * value


@njit(nogil=True, cache=True, error_model="numpy")
def _add_vertex(
    medium: Medium,
    table: Table,
    shares: Doubles,
    order: int,
    position: Vector,
    leg: tuple[Vector, float, float],
    sun: Vector,
    reached: float,
    sums: Sums,
) -> None:
    """Connect a vertex to the sun and add its weights.

    Args:
        leg: direction of the last one, its cosine with the one before, and the optical length of all.
        reached: probability of having come so far and of being connected.
    """
    values, clearance, box, stride, farthest = medium
    asymmetry, asymmetry_anchors, odds, last, anchor_last, extinction, extinction_anchors = table
    of_node, of_square, product, density, of_g, of_s = sums
    turned, cosine, passed = leg
    cosine_sun = cosine_between(sun, turned)
    weight = 1.0 / (_sampled(order, cosine, cosine_sun, asymmetry_anchors, odds, anchor_last, density) * reached)
    for g in range(len(asymmetry)):
        of_g[g] = 0.0
        if last[g] >= order:
            of_g[g] = product[g] * phase(cosine, asymmetry[g]) * phase(cosine_sun, asymmetry[g]) * weight
    sun_length = fly(values, clearance, box, stride, position, sun, farthest)[2]
    _connect(order, passed, sun_length, extinction, extinction_anchors, of_s)
    for knot in range(len(shares)):
        if shares[knot] != 0.0:
            _deposit(shares[knot], of_g, of_s, of_node[knot], of_square[knot])


@njit(nogil=True, cache=True, error_model="numpy")
def _trace_path(
    medium: Medium, table: Table, plan: Plan, position: Vector, direction: Vector, sun: Vector, key: int, sums: Sums
) -> None:
    """Follow one path and add its weights to the sums `(knot, asymmetry, extinction)`."""
    values, clearance, box, stride, _ = medium
    asymmetry, asymmetry_anchors, odds, _, anchor_last, _, extinction_anchors = table
    continuation, connection, shares = plan
    product, density = sums[2], sums[3]
    product[:], density[:] = 1.0, 1.0
    chosen = _choose(uniform(key, ASYMMETRY_DRAW), odds)
    lobe = asymmetry_anchors[chosen]
    thickness = extinction_anchors.shape[1]
    anchor = np.float32(extinction_anchors[0, min(int(uniform(key, EXTINCTION_DRAW) * thickness), thickness - 1)])
    passed, reached = np.float32(0.0), 1.0
    for order in range(2, min(len(continuation) + 1, anchor_last[chosen]) + 1):
        dimension = 2 + DRAWS * (order - 2)
        if not uniform(key, dimension + CONTINUATION) < continuation[order - 2]:
            return
        reached *= continuation[order - 2]
        linked, share = reached * connection[order - 2], shares[order - 2]
        if uniform(key, dimension + BRANCH) < connection[order - 2] * lobe * lobe:
            first, second = uniform(key, dimension + BRANCH_COSINE), uniform(key, dimension + BRANCH_AZIMUTH)
            turned = turn(sun, lobe, first, second)
            target = -np.float32(math.log(uniform(key, dimension + BRANCH_FLIGHT))) / anchor
            hit, end, used = fly(values, clearance, box, stride, position, turned, target)
            if hit:
                leg = (turned, cosine_between(direction, turned), passed + used)
                _add_vertex(medium, table, share, order, end, leg, sun, linked, sums)
        turned = turn(direction, lobe, uniform(key, dimension + COSINE), uniform(key, dimension + AZIMUTH))
        target = -np.float32(math.log(uniform(key, dimension + FLIGHT))) / anchor
        hit, position, used = fly(values, clearance, box, stride, position, turned, target)
        if not hit:
            return
        passed += used
        cosine = cosine_between(direction, turned)
        if uniform(key, dimension + CONNECTION) < connection[order - 2]:
            _add_vertex(medium, table, share, order, position, (turned, cosine, passed), sun, linked, sums)
        _scatter(cosine, asymmetry, asymmetry_anchors, product, density)
        direction = turned


@njit(nogil=True, cache=True, error_model="numpy")
def _trace_points(
    medium: Medium,
    table: Table,
    plan: Plan,
    points: Points,
    stream: int,
    source: Floats,
    squares: Doubles,
    first: int,
    last: int,
) -> None:
    """Means over the paths of each point, into `source` `(extinction, point, half, knot, asymmetry)`, and sums of squares."""
    position, direction, sun, counts, counters = points
    knots, lobes, thickness = plan[2].shape[1], len(table[0]), table[5].shape[1]
    product, density = np.empty(lobes), np.empty(len(table[1]))
    of_g, of_s = np.empty(lobes), np.empty(thickness)
    means = np.empty((knots, lobes, thickness))
    towards = (sun[0], sun[1], sun[2])
    for p in range(first, last):
        start = (position[p, 0], position[p, 1], position[p, 2])
        heading = (direction[p, 0], direction[p, 1], direction[p, 2])
        size = counts[p] // 2
        for half in range(2):
            means[:] = 0.0
            for path in range(half * size, (half + 1) * size):
                key = mix(stream + np.uint64(counters[p] + path + 1) * GOLDEN)
                sums = (means, squares, product, density, of_g, of_s)
                _trace_path(medium, table, plan, start, heading, towards, key, sums)
            for s in range(thickness):
                source[s, p, half] = means[:, :, s] / size


@torch.library.custom_op("cloudfit::trace_paths", mutates_args=())
def trace_paths(
    values: Tensor,
    clearance: Tensor,
    box: Tensor,
    stride: float,
    farthest: float,
    position: Tensor,
    direction: Tensor,
    sun_direction: Tensor,
    counts: Tensor,
    counters: Tensor,
    asymmetry: Tensor,
    asymmetry_anchors: Tensor,
    asymmetry_odds: Tensor,
    asymmetry_last: Tensor,
    anchor_last: Tensor,
    extinction: Tensor,
    extinction_anchors: Tensor,
    continuation: Tensor,
    connection: Tensor,
    shares: Tensor,
    stream: int,
) -> tuple[Tensor, Tensor]:
    """Trace paths from points and sum their weights.

    Args:
        values: densities `(z, y, x)`, no axis shorter than two.
        clearance: of their cells, see `measure_clearance`.
        box: lower corner, upper corner and edges of a voxel `(3, 3)` [m].
        stride: longest marching step [m].
        farthest: optical length to the sun beyond which nothing is lit [m].
        position, direction: of the points and of the camera rays there `(point, 3)`.
        sun_direction: unit vector towards the sun `(3,)`.
        counts: paths of each point `(point,)`, even.
        counters: number of each point's first path `(point,)`.
        asymmetry, asymmetry_anchors, asymmetry_odds: see `TableNodes`.
        asymmetry_last, anchor_last: last orders of the asymmetries and of their anchors, int64.
        extinction, extinction_anchors: see `TableNodes`.
        continuation, connection, shares: see `OrderPlan`.
        stream: from `stream_number`.

    Returns:
        Mean weights of both halves of the paths `(extinction, point, half, knot, asymmetry)` [1/sr], and the sums over all paths of their
        squares `(knot, asymmetry, extinction)`.
    """
    announce_compilation("fused_paths", _trace_points.stats.cache_path)
    knots, lobes, thickness = shares.shape[1], len(asymmetry), len(extinction)
    source = torch.empty(thickness, len(position), 2, knots, lobes)
    chunks = max(1, math.ceil(len(position) / CHUNK))
    squares = torch.zeros(chunks, knots, lobes, thickness, dtype=torch.float64)
    medium = (values.numpy(), clearance.numpy(), box.numpy(), np.float32(stride), np.float32(farthest))
    table = (
        *(tensor.numpy() for tensor in (asymmetry, asymmetry_anchors, asymmetry_odds, asymmetry_last, anchor_last)),
        _with_logarithm(extinction),
        _with_logarithm(extinction_anchors),
    )
    plan = (continuation.numpy(), connection.numpy(), shares.numpy())
    points = tuple(tensor.contiguous().numpy() for tensor in (position, direction, sun_direction, counts, counters))
    out, of_chunk = source.numpy(), squares.numpy()

    def work(first: int, last: int) -> None:
        _trace_points(medium, table, plan, points, np.uint64(stream), out, of_chunk[first // CHUNK], first, last)

    run_in_threads(work, len(position), CHUNK)
    return source, squares.sum(0)


def _with_logarithm(extinction: Tensor) -> Doubles:
    return torch.stack([extinction.double(), extinction.double().log()]).numpy()
