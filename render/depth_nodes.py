"""Where a table's extinctions lie, and the coordinate over which its images are interpolated.

Images of a thin cloud are powers of its extinction, so once the power is divided out they hardly change until the longest ray has an
optical depth of about one; from there on they change with the logarithm. Evenly spaced steps of

    w = ln(1 + s / s_0),    s_0 = 2 / largest optical length,

follow both. With 11 nodes over depths of 0.05 to 60 single scattering between the nodes is within 0.1 to 0.4 per cent, with nodes evenly
spaced in ln s 0.2 to 2 per cent, most in thick clouds, where they are rarest.
"""

import math

import torch
from torch import Tensor

from render.errors import ParameterError

SOFT_DEPTH = 2.0
"""Optical depth of the longest ray at s_0."""

FEWEST_NODES = 3
"""Of any table: what is left of a thin cloud's image without the power is nearly a straight line."""


def depth_coordinate(extinction: Tensor, soft: Tensor | float) -> Tensor:
    """w of extinctions [1/m], `soft` being s_0 [1/m]."""
    return torch.log1p(extinction / soft)


def count_depths(thin: float, thick: float, step: float) -> int:
    """Nodes that leave at most a step of w between neighbours. Raises ParameterError for depths that do not rise from above zero."""
    first, last = _range_of_depths(thin, thick)
    return max(FEWEST_NODES, 1 + math.ceil((last - first) / step))


def step_of_depths(thin: float, thick: float, count: int) -> float:
    """Step of w for which `count_depths` gives so many nodes, three or more."""
    first, last = _range_of_depths(thin, thick)
    return (last - first) / (count - 1) * (1.0 + 1e-9)


def place_depths(thin: float, thick: float, count: int) -> Tensor:
    """Largest optical depths `(count,)`, float64, evenly spaced in w between two."""
    first, last = _range_of_depths(thin, thick)
    return SOFT_DEPTH * torch.expm1(torch.linspace(first, last, count, dtype=torch.float64))


def _range_of_depths(thin: float, thick: float) -> tuple[float, float]:
    if not 0.0 < thin < thick < math.inf:
        raise ParameterError(f"optical depths must rise from above zero to a finite number, not from {thin} to {thick}")
    return math.log1p(thin / SOFT_DEPTH), math.log1p(thick / SOFT_DEPTH)
