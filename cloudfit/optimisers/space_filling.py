"""Points spread evenly over the unit cube, for methods that begin with a look around."""

import torch
from torch import Tensor


def space_filling_points(count: int, dimension: int, seed: int, start: Tensor | None = None) -> Tensor:
    """The first points of a scrambled Sobol sequence, the start before them if there is one.

    Args:
        count: number of points, the start included.
        dimension: number of parameters.
        seed: of the scrambling.
        start: (parameter,) in the unit cube.

    Returns:
        (count, parameter) float64.
    """
    points = torch.quasirandom.SobolEngine(dimension, scramble=True, seed=seed).draw(count, dtype=torch.float64)
    return points if start is None else torch.cat([start[None].double(), points[:-1]])
