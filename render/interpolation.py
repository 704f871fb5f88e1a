"""Cubic interpolation between table nodes: as a matrix, so that a whole population is one product, or with slopes that cannot overshoot."""

import torch
from torch import Tensor

from render.errors import ParameterError

SLOPE_POINTS, LIMITED_POINTS = 5, 3
"""Nodes that the slope at a node is made of; where there may be cliffs, those that a cliff can bend are fewer."""


def cubic_weights(nodes: Tensor, values: Tensor) -> Tensor:
    """Weights that turn samples at nodes into interpolated values.

    Piecewise cubic Hermite polynomials whose slopes at the nodes are those of the quartic through five neighbours: reproduces cubics,
    is continuous with its derivative, and touches six nodes at most. Slopes of parabolas through three (Catmull-Rom) made single
    scattering between the nodes of a table three times as wrong. Values outside the nodes are held at the border. One node alone
    gives a constant.

    Args:
        nodes: rising positions `(node,)`.
        values: where to interpolate `(population,)`; gradients flow through.

    Returns:
        Weights `(population, node)`; every row sums to one.

    Raises:
        ParameterError: if the nodes do not rise.
    """
    nodes = nodes.to(values)
    if len(nodes) == 1:
        return torch.ones_like(values)[:, None]
    cell, width, t = _locate(nodes, values)
    slopes = _slope_matrix(nodes, SLOPE_POINTS)
    unit = torch.eye(len(nodes), dtype=nodes.dtype, device=nodes.device)
    return _hermite(t[:, None], width[:, None], unit[cell], unit[cell + 1], slopes[cell], slopes[cell + 1])


def limited_slopes(nodes: Tensor, samples: Tensor, points: int = LIMITED_POINTS) -> Tensor:
    """Slopes at nodes for `interpolate_limited`: those of polynomials through some nodes, at most three times either neighbouring secant.

    This is the filter of Hyman 1983, "Accurate monotonicity preserving cubic interpolation": beside a cliff the curve stays within the
    range of its two samples; where neighbouring secants are alike it changes nothing.

    Args:
        nodes: rising positions `(node,)`.
        samples: values there `(..., node)`.
        points: nodes that each slope is made of.

    Returns:
        Slopes `(..., node)`.

    Raises:
        ParameterError: if the nodes do not rise.
    """
    nodes = nodes.to(samples)
    if len(nodes) == 1:
        return torch.zeros_like(samples)
    _require_rising(nodes)
    secants = samples.diff(dim=-1) / nodes.diff()
    before, after = (torch.cat(pair, dim=-1) for pair in ((secants[..., :1], secants), (secants, secants[..., -1:])))
    bound = 3.0 * torch.minimum(before.abs(), after.abs())
    return (samples @ _slope_matrix(nodes, points).T).maximum(-bound).minimum(bound)


def interpolate_limited(nodes: Tensor, samples: Tensor, slopes: Tensor, values: Tensor) -> Tensor:
    """Piecewise cubic interpolation with given slopes.

    Args:
        nodes: rising positions `(node,)`.
        samples, slopes: at the nodes `(row, node)`.
        values: where to interpolate `(population,)`, held at the border; gradients flow through.

    Returns:
        Interpolated values `(population, row)`.
    """
    nodes = nodes.to(values)
    if len(nodes) == 1:
        return samples.T.expand(len(values), -1)
    cell, width, t = _locate(nodes, values)
    low, high = samples[:, cell].T, samples[:, cell + 1].T
    return _hermite(t[:, None], width[:, None], low, high, slopes[:, cell].T, slopes[:, cell + 1].T)


def interpolate_limited_each(nodes: Tensor, samples: Tensor, values: Tensor) -> Tensor:
    """Piecewise cubic interpolation of samples of each value's own: the slopes of `cubic_weights`, limited like those of `limited_slopes`.

    Args:
        nodes: rising positions `(node,)`.
        samples: at the nodes `(population, row, node)`.
        values: where to interpolate `(population,)`, held at the border; gradients flow through.

    Returns:
        Interpolated values `(population, row)`.
    """
    nodes = nodes.to(values)
    if len(nodes) == 1:
        return samples[..., 0]
    cell, width, t = _locate(nodes, values)
    slopes = limited_slopes(nodes, samples, SLOPE_POINTS)

    def at(node: Tensor, table: Tensor) -> Tensor:
        return table.take_along_dim(node[:, None, None], dim=2)[..., 0]

    ends = at(cell, samples), at(cell + 1, samples), at(cell, slopes), at(cell + 1, slopes)
    return _hermite(t[:, None], width[:, None], *ends)


def _locate(nodes: Tensor, values: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Cell of each value, held at the border, the cell's width and the fraction of it `(population,)`."""
    _require_rising(nodes)
    held = values.clamp(float(nodes[0]), float(nodes[-1]))
    cell = (torch.searchsorted(nodes, held.detach().contiguous(), right=True) - 1).clamp(0, len(nodes) - 2)
    width = nodes[cell + 1] - nodes[cell]
    return cell, width, (held - nodes[cell]) / width


def _hermite(t: Tensor, width: Tensor, low: Tensor, high: Tensor, low_slope: Tensor, high_slope: Tensor) -> Tensor:
    return (
        (1.0 + 2.0 * t) * (1.0 - t) ** 2 * low
        + t * (1.0 - t) ** 2 * width * low_slope
        + t * t * (3.0 - 2.0 * t) * high
        - t * t * (1.0 - t) * width * high_slope
    )


def _require_rising(nodes: Tensor) -> None:
    if not bool((nodes.diff() > 0).all()):
        raise ParameterError(f"table nodes must rise from each to the next, not {nodes.tolist()}")


def _slope_matrix(nodes: Tensor, most: int) -> Tensor:
    """Matrix `(node, node)` from samples to the slopes at each node of the polynomial through it and its neighbours, so many at most.

    Row by row the derivative of the barycentric form (Berrut & Trefethen 2004, "Barycentric Lagrange interpolation", equation 9.4).
    """
    count = len(nodes)
    points = min(most, count)
    own = torch.arange(count, device=nodes.device)
    first = (own - points // 2).clamp(0, count - points)
    columns = first[:, None] + torch.arange(points, device=nodes.device)
    near = nodes[columns]
    apart = near[:, :, None] - near[:, None, :] + torch.eye(points, dtype=nodes.dtype, device=nodes.device)
    weight = 1.0 / apart.prod(-1)
    place = (own - first)[:, None]
    away = (nodes[:, None] - near).scatter(1, place, 1.0)
    slope = (weight / weight.gather(1, place) / away).scatter(1, place, 0.0)
    slope = slope.scatter(1, place, -slope.sum(1, keepdim=True))
    return torch.zeros(count, count, dtype=nodes.dtype, device=nodes.device).scatter(1, columns, slope)
