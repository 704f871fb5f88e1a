"""How far apart two depths are: the one measure by which interpolation tells a surface from the next."""

import torch
from torch import Tensor

from render.errors import ParameterError


def compute_log_depth(depth: Tensor) -> Tensor:
    """Natural logarithm of depths; infinite for the sky, minus infinite at the eye.

    Differences of logarithms are ratios of depths, so a tolerance means the same near and far and in every unit of length.

    Args:
        depth: distances from the eye [m], not negative, any shape.

    Returns:
        Logarithms of the same shape.

    Raises:
        ParameterError: for a negative depth or NaN.
    """
    if not bool((depth >= 0.0).all()):
        raise ParameterError(
            "a depth must be a distance of at least 0 m, or infinite for the sky; some are negative or NaN"
        )
    return depth.log()


def depth_gap(first: Tensor, second: Tensor) -> Tensor:
    """Distance between logarithms of depths: 0 for equal ones, two of the sky included, infinite between sky and surface."""
    return torch.where(first == second, 0.0, (first - second).abs())
