"""Cubic interpolation between table nodes: as a matrix, so that a whole population is one product, or with slopes that cannot overshoot."""

import torch
from torch import Tensor

from render.errors import ParameterError


def cubic_weights(nodes: Tensor, values: Tensor) -> Tensor:
    """Weights that turn samples at nodes into interpolated values.

    Piecewise cubic Hermite polynomials whose slopes at the nodes are those of the parabola through three neighbours (Catmull-Rom for
    equidistant nodes): reproduces parabolas, is continuous with its derivative, and touches four nodes at most. Values outside
    the nodes are held at the border. One node alone gives a constant.

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
    slopes = _slope_matrix(nodes)
    unit = torch.eye(len(nodes), dtype=nodes.dtype, device=nodes.device)
    return _hermite(t[:, None], width[:, None], unit[cell], unit[cell + 1], slopes[cell], slopes[cell + 1])


def limited_slopes(nodes: Tensor, samples: Tensor) -> Tensor:
    """Slopes at nodes for `interpolate_limited`: those of `cubic_weights`, at most three times either neighbouring secant.

    This is the filter of Hyman 1983, "Accurate monotonicity preserving cubic interpolation": beside a cliff the curve stays within the
    range of its two samples; where neighbouring secants are alike it changes nothing.

    Args:
        nodes: rising positions `(node,)`.
        samples: values there `(..., node)`.

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
    return (samples @ _slope_matrix(nodes).T).maximum(-bound).minimum(bound)


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


def _slope_matrix(nodes: Tensor) -> Tensor:
    """Matrix `(node, node)` from samples to the slopes of the parabolas through each node and its neighbours."""
    count = len(nodes)
    slopes = torch.zeros(count, count, dtype=nodes.dtype, device=nodes.device)
    if count == 2:
        slopes[:, 0], slopes[:, 1] = -1.0 / (nodes[1] - nodes[0]), 1.0 / (nodes[1] - nodes[0])
        return slopes
    middle = torch.arange(count, device=nodes.device).clamp(1, count - 2)
    columns = middle[:, None] + torch.arange(-1, 2, device=nodes.device)
    near = nodes[columns]
    # For each of the three the other two, whose values the derivative of its Lagrange polynomial is made of.
    one, other = near[:, [1, 0, 0]], near[:, [2, 2, 1]]
    return slopes.scatter(1, columns, (2.0 * nodes[:, None] - one - other) / ((near - one) * (near - other)))
