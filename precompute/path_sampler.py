"""One set of paths for the whole (asymmetry x extinction) table.

Paths start at a point of the volume into which a camera ray looks. A path's expected contribution to the in-scattered radiance of
order k at that point, for any node (g, s) of the table, is a product of a factor in g and a factor in s:

    prod_i HG(c_i; g) HG(c_sun; g)    *    s^(k-1) exp(-s (U + u_sun))

c_i are the cosines of the k-1 scatterings up to the last vertex, U the optical length of the legs, u_sun that from the last vertex to
the sun. A path draws one asymmetry anchor g_a and one extinction anchor s_b. A narrow forward lobe seldom meets the sun, so before each
leg the path sends out, with probability g_a^2, a branch of one leg in a direction drawn from the lobe around the sun's. Leg and
branch are two samples of the same vertex and are weighed together, over all anchors (Veach & Guibas 1995, the balance heuristic):

    G = prod_i HG(c_i; g) HG(c_sun; g) / sum_a w_a prod_(i < k-1) HG(c_i; g_a) [ HG(c_(k-1); g_a) + g_a^2 HG(c'; g_a) ]
    S = s^(k-1) exp(-s U) / mean_b s_b^(k-1) exp(-s_b U)  * exp(-s u_sun)

c' is the cosine between the last leg and the sun. Nothing depends on the anchor drawn, each factor is bounded by the number of its
anchors, and no branch goes on, so that the bound does not grow with the order. All densities are kept as logarithms.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from enum import IntEnum

import torch
from torch import Tensor

from precompute.order_plan import OrderPlan
from render.density_grid import DensityGrid
from render.free_flight import fly, march_to_sun
from render.phase_functions import evaluate_phase_function, rotate_direction, sample_phase_cosine
from render.random_streams import counter_uniform

EVERY_ORDER = 1 << 30
"""Last order of asymmetries that are followed as far as the plan goes."""

FORWARD_EXPONENT = 1.0
"""Anchors are drawn in proportion to 1 / (1 - |g|) to this power."""


def every_order(asymmetry: Tensor) -> Tensor:
    """Last order that paths are followed for at each asymmetry: none is the last."""
    return torch.full(asymmetry.shape, EVERY_ORDER)


@dataclass(frozen=True, eq=False)
class TableNodes:
    """Nodes of the table and the anchors from which paths are drawn.

    Args:
        asymmetry: nodes `(asymmetry,)`, rising.
        extinction: nodes `(extinction,)` [1/m], rising, positive.
        asymmetry_anchors: subset or superset of the nodes that directions are drawn from `(anchor,)`.
        extinction_anchors: likewise for free flights `(anchor,)` [1/m].
        last_order: gives for asymmetries the last order that is traced; paths of an anchor end there, and nodes get no more.
    """

    asymmetry: Tensor
    extinction: Tensor
    asymmetry_anchors: Tensor
    extinction_anchors: Tensor
    last_order: Callable[[Tensor], Tensor] = every_order

    @property
    def asymmetry_odds(self) -> Tensor:
        """Probability of each asymmetry anchor `(anchor,)` float64: forward lobes are noisier and get more paths."""
        odds = (1.0 - self.asymmetry_anchors.double().abs()) ** -FORWARD_EXPONENT
        return odds / odds.sum()


@dataclass(frozen=True, eq=False)
class VertexWeights:
    """Weights of the paths that reach a vertex.

    Args:
        order: number of scatterings, counting the one at the start point.
        path: numbers of these paths in the batch `(path,)`.
        asymmetry_factor: G `(path, asymmetry)` [1/sr].
        extinction_factor: S `(path, extinction)`, dimensionless, over the probability of having gone on so far.
    """

    order: int
    path: Tensor
    asymmetry_factor: Tensor
    extinction_factor: Tensor


class Draw(IntEnum):
    """Which random number of a path is used for what: those of order k follow at 2 + 9 (k - 2)."""

    CONTINUATION = 0
    COSINE = 1
    AZIMUTH = 2
    FLIGHT = 3
    CONNECTION = 4
    BRANCH = 5
    BRANCH_COSINE = 6
    BRANCH_AZIMUTH = 7
    BRANCH_FLIGHT = 8

    def of_order(self, order: int) -> int:
        """Dimension of this number at a scattering order."""
        return 2 + len(Draw) * (order - 2) + self


ASYMMETRY_DRAW, EXTINCTION_DRAW = 0, 1

LEG_DRAWS = (Draw.COSINE, Draw.AZIMUTH, Draw.FLIGHT)
BRANCH_DRAWS = (Draw.BRANCH_COSINE, Draw.BRANCH_AZIMUTH, Draw.BRANCH_FLIGHT)


@dataclass(frozen=True, eq=False)
class _Paths:
    """Paths at a vertex.

    Args:
        path: their numbers in the batch `(path,)`.
        position, direction: of the vertex and of the leg to it `(path, 3)`.
        log_phase: of the scatterings so far `(path, asymmetry)`.
        log_density: of the directions of all legs, if every one was a leg of the path itself `(path, anchor)`.
        log_sampled: the same with the branch as a second sample of the last one `(path, anchor)`.
        passed: optical length of the legs `(path,)` [m].
    """

    path: Tensor
    position: Tensor
    direction: Tensor
    log_phase: Tensor
    log_density: Tensor
    log_sampled: Tensor
    passed: Tensor

    def keep(self, rows: Tensor) -> "_Paths":
        """Some of the paths."""
        return _Paths(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class _Tracer:
    """What a batch of paths is traced through and with; arguments as of `sample_paths`."""

    grid: DensityGrid
    sun: Tensor
    nodes: TableNodes
    step: float
    keys: Tensor
    asymmetry: Tensor
    extinction: Tensor

    def depart(self, position: Tensor, direction: Tensor) -> _Paths:
        """Paths at their start points."""
        count = len(position)
        density = torch.zeros(count, len(self.nodes.asymmetry_anchors))
        phase = torch.zeros(count, len(self.nodes.asymmetry))
        return _Paths(torch.arange(count), position, direction, phase, density, density, torch.zeros(count))

    def happens(self, paths: _Paths, draw: Draw, order: int, probability: Tensor | float) -> Tensor:
        """Which paths do something that has a probability `(path,)` bool."""
        return counter_uniform(self.keys[paths.path], draw.of_order(order)) < probability

    def advance(self, paths: _Paths, axis: Tensor, order: int, draws: tuple[Draw, Draw, Draw]) -> _Paths:
        """Follow one leg, its direction drawn around an axis `(path, 3)`; the paths that end in a vertex inside."""
        key = self.keys[paths.path]
        uniform = [counter_uniform(key, draw.of_order(order)) for draw in draws]
        cosine = sample_phase_cosine(self.asymmetry[paths.path], uniform[0])
        turned = rotate_direction(axis, cosine, 2.0 * math.pi * uniform[1])
        flight = fly(self.grid, paths.position, turned, -uniform[2].log() / self.extinction[paths.path], self.step)
        kept = torch.nonzero(flight.collided).flatten()
        before, direction = paths.keep(kept), turned[kept]
        cosine = (before.direction * direction).sum(1, keepdim=True)
        anchors = self.nodes.asymmetry_anchors
        own = evaluate_phase_function(cosine, anchors)
        branch = branch_probability(anchors) * evaluate_phase_function((direction @ self.sun)[:, None], anchors)
        return _Paths(
            before.path,
            flight.position[kept],
            direction,
            before.log_phase + _log_phase(cosine, self.nodes.asymmetry),
            before.log_density + own.log(),
            before.log_density + (own + branch).log(),
            before.passed + flight.optical_length[kept],
        )

    def connect(self, paths: _Paths, order: int, probability: float) -> VertexWeights:
        """Weights of vertices that are connected to the sun; `probability` is that of having come there and being connected."""
        log_phase = paths.log_phase + _log_phase((paths.direction @ self.sun)[:, None], self.nodes.asymmetry)
        nodes = self.nodes
        going = nodes.last_order(nodes.asymmetry_anchors) >= order
        odds = torch.where(going, nodes.asymmetry_odds, 0.0).log().float()
        log_sampled = torch.logsumexp(paths.log_sampled + odds, dim=1, keepdim=True)
        of_extinction = _extinction_factor(
            self.grid, order, paths.position, self.sun, self.nodes, paths.passed, self.step
        )
        of_asymmetry = (log_phase - log_sampled).exp() * (nodes.last_order(nodes.asymmetry) >= order)
        return VertexWeights(order, paths.path, of_asymmetry, of_extinction / probability)


def sample_paths(
    grid: DensityGrid,
    position: Tensor,
    direction: Tensor,
    sun_direction: Tensor,
    nodes: TableNodes,
    plan: OrderPlan,
    step: float,
    keys: Tensor,
) -> Iterator[VertexWeights]:
    """Trace paths and yield their weights vertex by vertex, from order two upwards.

    Args:
        grid: the volume.
        position: start points `(path, 3)` [m].
        direction: of travel of the camera ray at each start point `(path, 3)`, unit vectors.
        sun_direction: unit vector towards the sun `(3,)`.
        nodes: of the table, and anchors.
        plan: orders to trace; their sharing of images is not this function's business.
        step: longest marching step in voxels.
        keys: of the paths' random numbers `(path,)`, from `counter_keys`.

    Yields:
        Weights for order 2, 3, ..., of the ends of branches and of the paths' own vertices by turns; paths that have left the
        volume or were not continued are missing and count as zero.
    """
    even = torch.full_like(nodes.extinction_anchors, 1.0 / len(nodes.extinction_anchors), dtype=torch.float64)
    asymmetry = _choose(nodes.asymmetry_anchors, nodes.asymmetry_odds, counter_uniform(keys, ASYMMETRY_DRAW))
    extinction = _choose(nodes.extinction_anchors, even, counter_uniform(keys, EXTINCTION_DRAW))
    tracer = _Tracer(grid, sun_direction, nodes, step, keys, asymmetry, extinction)
    paths, reached = tracer.depart(position, direction), 1.0
    for order, (continuation, connection) in enumerate(
        zip(plan.continuation.tolist(), plan.connection.tolist(), strict=True), start=2
    ):
        goes_on = tracer.happens(paths, Draw.CONTINUATION, order, continuation)
        paths = paths.keep(goes_on & (nodes.last_order(asymmetry[paths.path]) >= order))
        reached *= continuation
        odds = connection * branch_probability(asymmetry[paths.path].double())
        branching = paths.keep(tracer.happens(paths, Draw.BRANCH, order, odds))
        branches = tracer.advance(branching, sun_direction.expand_as(branching.direction), order, BRANCH_DRAWS)
        yield tracer.connect(branches, order, reached * connection)
        paths = tracer.advance(paths, paths.direction, order, LEG_DRAWS)
        if len(paths.path) == 0:
            return
        connected = paths.keep(tracer.happens(paths, Draw.CONNECTION, order, connection))
        yield tracer.connect(connected, order, reached * connection)


def _extinction_factor(
    grid: DensityGrid,
    order: int,
    position: Tensor,
    sun_direction: Tensor,
    nodes: TableNodes,
    passed: Tensor,
    step: float,
) -> Tensor:
    """S of vertices `(path, extinction)`, connected to the sun."""
    sun_length = march_to_sun(grid, position, sun_direction, nodes.extinction[0], step)
    log_flights = (order - 1) * nodes.extinction.log() - nodes.extinction * (passed + sun_length)[:, None]
    anchors = nodes.extinction_anchors
    log_anchors = (order - 1) * anchors.log() - anchors * passed[:, None]
    return (log_flights - _log_mean_exp(log_anchors)).exp()


def branch_probability(asymmetry: Tensor) -> Tensor:
    """Of sending out a branch at a vertex: for isotropic scattering it would be one more of the same."""
    return asymmetry**2


def _choose(anchors: Tensor, odds: Tensor, uniform: Tensor) -> Tensor:
    return anchors[torch.searchsorted(odds.cumsum(0)[:-1], uniform.double(), right=True)]


def _log_phase(cosine: Tensor, asymmetry: Tensor) -> Tensor:
    """Logarithm of the phase function `(path, node)` for cosines `(path, 1)`."""
    return evaluate_phase_function(cosine, asymmetry).log()


def _log_mean_exp(values: Tensor) -> Tensor:
    return torch.logsumexp(values, dim=1, keepdim=True) - math.log(values.shape[1])
