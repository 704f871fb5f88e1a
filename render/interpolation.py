"""Cubic interpolation between table nodes, as a matrix, so that a whole population is one product."""

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
    if not bool((nodes.diff() > 0).all()):
        raise ParameterError(f"table nodes must rise from each to the next, not {nodes.tolist()}")
    held = values.clamp(float(nodes[0]), float(nodes[-1]))
    cell = (torch.searchsorted(nodes, held.detach().contiguous(), right=True) - 1).clamp(0, len(nodes) - 2)
    width = nodes[cell + 1] - nodes[cell]
    t = ((held - nodes[cell]) / width)[:, None]
    slopes = _slope_matrix(nodes)
    unit = torch.eye(len(nodes), dtype=nodes.dtype, device=nodes.device)
    return (
        (1.0 + 2.0 * t) * (1.0 - t) ** 2 * unit[cell]
        + t * (1.0 - t) ** 2 * width[:, None] * slopes[cell]
        + t * t * (3.0 - 2.0 * t) * unit[cell + 1]
        - t * t * (1.0 - t) * width[:, None] * slopes[cell + 1]
    )


def _slope_matrix(nodes: Tensor) -> Tensor:
    """Matrix `(node, node)` from samples to the slopes of the parabolas through each node and its neighbours."""
    count = len(nodes)
    slopes = torch.zeros(count, count, dtype=nodes.dtype, device=nodes.device)
    if count == 2:
        slopes[:, 0], slopes[:, 1] = -1.0 / (nodes[1] - nodes[0]), 1.0 / (nodes[1] - nodes[0])
        return slopes
    for node in range(count):
        middle = min(max(node, 1), count - 2)
        three = nodes[middle - 1 : middle + 2]
        for k in range(3):
            others = [j for j in range(3) if j != k]
            numerator = 2.0 * nodes[node] - three[others[0]] - three[others[1]]
            slopes[node, middle - 1 + k] = numerator / ((three[k] - three[others[0]]) * (three[k] - three[others[1]]))
    return slopes
