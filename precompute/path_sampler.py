"""One set of paths for the whole (asymmetry x extinction) table.

Paths start at a point of the volume into which a camera ray looks. A path's expected contribution to the in-scattered radiance of
order k at that point, for any node (g, s) of the table, is a product of a factor in g and a factor in s:

    prod_i HG(c_i; g) HG(c_sun; g)    *    s^(k-1) exp(-s (U + u_sun))

c_i are the cosines of the k-1 scatterings up to the last vertex, U the optical length of the legs, u_sun that from the last vertex to
the sun. A path draws one asymmetry anchor g_a and one extinction anchor s_b, and each direction with probability p from the lobe
around the sun's direction of travel instead of its own. It is weighed with the density of the whole mixture (Veach & Guibas 1995, the
balance heuristic), so each factor is bounded by the number of its anchors and nothing depends on the anchor drawn:

    G = prod_i HG(c_i; g) / sum_a w_a prod_i [(1-p) HG(c_i; g_a) + p HG(c'_i; g_a)]  * HG(c_sun; g)
    S = s^(k-1) exp(-s U) / mean_b s_b^(k-1) exp(-s_b U)  * exp(-s u_sun)

c'_i is the cosine between the new direction and the sun. All densities are kept as logarithms.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import torch
from torch import Tensor

from precompute.free_flight import fly, march_to_sun
from precompute.order_plan import OrderPlan
from render.density_grid import DensityGrid
from render.phase_functions import evaluate_phase_function, rotate_direction, sample_phase_cosine
from render.random_streams import counter_uniform

FORWARD_EXPONENT = 0.5
"""Anchors are drawn in proportion to 1 / (1 - |g|) to this power."""


@dataclass(frozen=True, eq=False)
class TableNodes:
    """Nodes of the table and the anchors from which paths are drawn.

    Args:
        asymmetry: nodes `(asymmetry,)`, rising.
        extinction: nodes `(extinction,)` [1/m], rising, positive.
        asymmetry_anchors: subset or superset of the nodes that directions are drawn from `(anchor,)`.
        extinction_anchors: likewise for free flights `(anchor,)` [1/m].
    """

    asymmetry: Tensor
    extinction: Tensor
    asymmetry_anchors: Tensor
    extinction_anchors: Tensor

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
    """Which random number of a path is used for what: those of order k follow at 2 + 6 (k - 2)."""

    CONTINUATION = 0
    LOBE = 1
    COSINE = 2
    AZIMUTH = 3
    FLIGHT = 4
    CONNECTION = 5

    def of_order(self, order: int) -> int:
        """Dimension of this number at a scattering order."""
        return 2 + len(Draw) * (order - 2) + self


ASYMMETRY_DRAW, EXTINCTION_DRAW = 0, 1


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
        Weights for order 2, 3, ...; paths that have left the volume or were not continued are missing and count as zero.
    """
    count = len(position)
    odds = nodes.asymmetry_odds
    asymmetry_anchor = _choose(nodes.asymmetry_anchors, odds, counter_uniform(keys, ASYMMETRY_DRAW))
    even = torch.full_like(nodes.extinction_anchors, 1.0 / len(nodes.extinction_anchors), dtype=torch.float64)
    extinction_anchor = _choose(nodes.extinction_anchors, even, counter_uniform(keys, EXTINCTION_DRAW))
    log_phase = torch.zeros(count, len(nodes.asymmetry))
    log_density = torch.zeros(count, len(nodes.asymmetry_anchors))
    passed, reached = torch.zeros(count), 1.0
    path = torch.arange(count)
    for order, (probability, connection, sun_lobe) in enumerate(
        zip(plan.continuation.tolist(), plan.connection.tolist(), plan.sun_lobe.tolist(), strict=True), start=2
    ):
        going_on = torch.nonzero(counter_uniform(keys[path], Draw.CONTINUATION.of_order(order)) < probability).flatten()
        key, start, heading = keys[path[going_on]], position[going_on], direction[going_on]
        turned = _draw_direction(heading, sun_direction, asymmetry_anchor[path[going_on]], key, order, sun_lobe)
        target = -counter_uniform(key, Draw.FLIGHT.of_order(order)).log() / extinction_anchor[path[going_on]]
        flight = fly(grid, start, turned, target, step)
        collided = torch.nonzero(flight.collided).flatten()
        kept = going_on[collided]
        if len(kept) == 0:
            return
        reached *= probability
        direction, position, path = turned[collided], flight.position[collided], path[kept]
        cosine = (heading[collided] * direction).sum(1, keepdim=True)
        log_phase = log_phase[kept] + _log_phase(cosine, nodes.asymmetry)
        log_density = log_density[kept] + _log_mixture(
            cosine, direction @ sun_direction, nodes.asymmetry_anchors, sun_lobe
        )
        passed = passed[kept] + flight.optical_length[collided]
        connected = counter_uniform(keys[path], Draw.CONNECTION.of_order(order)) < connection
        of_asymmetry = log_phase + _log_phase((direction @ sun_direction)[:, None], nodes.asymmetry)
        of_asymmetry = (of_asymmetry - torch.logsumexp(log_density + odds.log().float(), dim=1, keepdim=True)).exp()
        of_extinction = _extinction_factor(
            grid, order, position[connected], sun_direction, nodes, passed[connected], step
        )
        yield VertexWeights(order, path[connected], of_asymmetry[connected], of_extinction / (reached * connection))


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


def _choose(anchors: Tensor, odds: Tensor, uniform: Tensor) -> Tensor:
    return anchors[torch.searchsorted(odds.cumsum(0)[:-1], uniform.double(), right=True)]


def _draw_direction(
    direction: Tensor, sun_direction: Tensor, asymmetry: Tensor, keys: Tensor, order: int, sun_lobe: float
) -> Tensor:
    """New directions from the lobe around the path's own direction or, with a given probability, around the sun's.

    A path is traced against the light, so the direction in which it would meet the light head on is the one towards the sun.
    """
    towards_sun = counter_uniform(keys, Draw.LOBE.of_order(order)) < sun_lobe
    axis = torch.where(towards_sun[:, None], sun_direction, direction)
    cosine = sample_phase_cosine(asymmetry, counter_uniform(keys, Draw.COSINE.of_order(order)))
    return rotate_direction(axis, cosine, 2.0 * math.pi * counter_uniform(keys, Draw.AZIMUTH.of_order(order)))


def _log_phase(cosine: Tensor, asymmetry: Tensor) -> Tensor:
    """Logarithm of the phase function `(path, node)` for cosines `(path, 1)`."""
    return evaluate_phase_function(cosine, asymmetry).log()


def _log_mixture(cosine: Tensor, cosine_sun: Tensor, anchors: Tensor, sun_lobe: float) -> Tensor:
    """Logarithm of each anchor's density of a direction `(path, anchor)` [1/sr]."""
    own = (1.0 - sun_lobe) * evaluate_phase_function(cosine, anchors)
    return (own + sun_lobe * evaluate_phase_function(cosine_sun[:, None], anchors)).log()


def _log_mean_exp(values: Tensor) -> Tensor:
    return torch.logsumexp(values, dim=1, keepdim=True) - math.log(values.shape[1])
