"""One set of paths for the whole (asymmetry x extinction) table.

Paths start at a point of the volume into which a camera ray looks. A path's expected contribution to the in-scattered radiance of
order k at that point, for any node (g, s) of the table, is a product of a factor in g and a factor in s:

    prod_i HG(c_i; g) HG(c_sun; g)    *    s^(k-1) exp(-s (U + u_sun))

c_i are the cosines of the k-1 scatterings up to the last vertex, U the optical length of the legs, u_sun that from the last vertex to
the sun. A path draws one asymmetry anchor g_a and one extinction anchor s_b, and each direction with probability 0.3 from the lobe
around the sun's direction of travel instead of its own. It is weighed with the density of the whole mixture (Veach & Guibas 1995, the
balance heuristic), so each factor is bounded by the number of its anchors and nothing depends on the anchor drawn:

    G = prod_i HG(c_i; g) / mean_a prod_i [0.7 HG(c_i; g_a) + 0.3 HG(c'_i; g_a)]  * HG(c_sun; g)
    S = s^(k-1) exp(-s U) / mean_b s_b^(k-1) exp(-s_b U)  * exp(-s u_sun)

c'_i is the cosine between the new direction and the sun. All densities are kept as logarithms.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from precompute.free_flight import fly, march_to_sun
from render.density_grid import DensityGrid
from render.phase_functions import evaluate_phase_function, sample_directions

SUN_LOBE_PROBABILITY = 0.3
"""Share of directions drawn around the sun's own direction: a sixth of the noise at g = 0.9 under side light, for little elsewhere."""


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


@dataclass(frozen=True, eq=False)
class VertexWeights:
    """Weights of the paths that reach a vertex.

    Args:
        order: number of scatterings, counting the one at the start point.
        path: numbers of these paths in the batch `(path,)`.
        asymmetry_factor: G `(path, asymmetry)` [1/sr].
        extinction_factor: S `(path, extinction)`, dimensionless.
    """

    order: int
    path: Tensor
    asymmetry_factor: Tensor
    extinction_factor: Tensor


def sample_paths(
    grid: DensityGrid,
    position: Tensor,
    direction: Tensor,
    sun_direction: Tensor,
    nodes: TableNodes,
    orders: int,
    step: float,
    generator: torch.Generator,
) -> Iterator[VertexWeights]:
    """Trace paths and yield their weights vertex by vertex, from order two upwards.

    Args:
        grid: the volume.
        position: start points `(path, 3)` [m].
        direction: of travel of the camera ray at each start point `(path, 3)`, unit vectors.
        sun_direction: unit vector towards the sun `(3,)`.
        nodes: of the table, and anchors.
        orders: largest number of scatterings.
        step: longest marching step in voxels.
        generator: source of the random numbers.

    Yields:
        Weights for order 2, 3, ...; paths that have left the volume are missing and count as zero.
    """
    count = len(position)
    asymmetry_anchor = _draw(nodes.asymmetry_anchors, count, generator)
    extinction_anchor = _draw(nodes.extinction_anchors, count, generator)
    log_phase = torch.zeros(count, len(nodes.asymmetry))
    log_density = torch.zeros(count, len(nodes.asymmetry_anchors))
    passed = torch.zeros(count)
    path = torch.arange(count)
    for order in range(2, orders + 1):
        turned = _draw_direction(direction, sun_direction, asymmetry_anchor[path], generator)
        target = torch.empty(len(path)).exponential_(generator=generator) / extinction_anchor[path]
        flight = fly(grid, position, turned, target, step)
        kept = torch.nonzero(flight.collided).flatten()
        if len(kept) == 0:
            return
        before, direction, position, path = direction[kept], turned[kept], flight.position[kept], path[kept]
        cosine = (before * direction).sum(1, keepdim=True)
        log_phase = log_phase[kept] + _log_phase(cosine, nodes.asymmetry)
        log_density = log_density[kept] + _log_mixture(cosine, direction @ sun_direction, nodes.asymmetry_anchors)
        passed = passed[kept] + flight.optical_length[kept]
        yield _weigh(grid, order, path, position, direction, sun_direction, nodes, log_phase, log_density, passed, step)


def _weigh(
    grid: DensityGrid,
    order: int,
    path: Tensor,
    position: Tensor,
    direction: Tensor,
    sun_direction: Tensor,
    nodes: TableNodes,
    log_phase: Tensor,
    log_density: Tensor,
    passed: Tensor,
    step: float,
) -> VertexWeights:
    """Weights at the vertices reached, connected to the sun."""
    sun_length = march_to_sun(grid, position, sun_direction, nodes.extinction[0], step)
    log_sun = _log_phase((direction @ sun_direction)[:, None], nodes.asymmetry)
    log_g = log_phase + log_sun - _log_mean_exp(log_density)
    log_flights = (order - 1) * nodes.extinction.log() - nodes.extinction * (passed + sun_length)[:, None]
    anchors = nodes.extinction_anchors
    log_anchors = (order - 1) * anchors.log() - anchors * passed[:, None]
    return VertexWeights(order, path, log_g.exp(), (log_flights - _log_mean_exp(log_anchors)).exp())


def _draw(anchors: Tensor, count: int, generator: torch.Generator) -> Tensor:
    return anchors[torch.randint(len(anchors), (count,), generator=generator)]


def _draw_direction(direction: Tensor, sun_direction: Tensor, asymmetry: Tensor, generator: torch.Generator) -> Tensor:
    """New directions from the lobe around the path's own direction or, with probability 0.3, around the sun's.

    A path is traced against the light, so the direction in which it would meet the light head on is the one towards the sun.
    """
    towards_sun = torch.rand(len(direction), generator=generator) < SUN_LOBE_PROBABILITY
    axis = torch.where(towards_sun[:, None], sun_direction, direction)
    return sample_directions(axis, asymmetry, generator)


def _log_phase(cosine: Tensor, asymmetry: Tensor) -> Tensor:
    """Logarithm of the phase function `(path, node)` for cosines `(path, 1)`."""
    return evaluate_phase_function(cosine, asymmetry).log()


def _log_mixture(cosine: Tensor, cosine_sun: Tensor, anchors: Tensor) -> Tensor:
    """Logarithm of each anchor's density of a direction `(path, anchor)` [1/sr]."""
    own = (1.0 - SUN_LOBE_PROBABILITY) * evaluate_phase_function(cosine, anchors)
    return (own + SUN_LOBE_PROBABILITY * evaluate_phase_function(cosine_sun[:, None], anchors)).log()


def _log_mean_exp(values: Tensor) -> Tensor:
    return torch.logsumexp(values, dim=1, keepdim=True) - math.log(values.shape[1])
