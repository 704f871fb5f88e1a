"""How far it is from each cell of a volume to the nearest one that holds anything, so that marches may leap over nothing."""

import torch
from scipy.ndimage import distance_transform_cdt
from torch import Tensor

FARTHEST = 255
"""Cells; larger distances are held there, so that they fit into a byte."""


def measure_clearance(values: Tensor) -> Tensor:
    """Chebyshev distance to the nearest cell with a corner above zero: within fewer cells along every axis all values are zero.

    Args:
        values: at the corners of the cells `(z, y, x)`, not negative, no axis shorter than two.

    Returns:
        Distances `(z - 1, y - 1, x - 1)` uint8, zero in the cells that hold something, `FARTHEST` at most.
    """
    filled = values > 0.0
    for axis in range(3):
        count = filled.shape[axis] - 1
        filled = filled.narrow(axis, 0, count) | filled.narrow(axis, 1, count)
    if not bool(filled.any()):
        return torch.full(filled.shape, FARTHEST, dtype=torch.uint8)
    distance = torch.from_numpy(distance_transform_cdt(~filled.numpy(), metric="chessboard"))
    return distance.clamp(max=FARTHEST).to(torch.uint8)
