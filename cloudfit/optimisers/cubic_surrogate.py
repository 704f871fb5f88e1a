"""A cheap stand-in for a loss: cubic radial basis functions through the points that have been evaluated, smoothed.

    s(x) = sum_i w_i |x - x_i|^3 + b + a x,    (Phi + ridge I) w + P (b, a) = f,    P^T w = 0

Phi holds |x_i - x_j|^3 and P the rows (1, x_i); Regis and Shoemaker 2007, section 2. The cubic kernel has no length scale to be
fitted, and the ridge keeps the small steps of a histogram loss out.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from cloudfit.optimisers.base import PENALTY

RIDGE = 1e-3
"""Smoothing, as a share of the median entry of Phi."""

LEAST_RIDGE = 1e-10
"""Keeps the equations solvable where points coincide."""


@dataclass(frozen=True, eq=False)
class CubicSurrogate:
    """A fitted stand-in.

    Args:
        points: (point, parameter) x_i.
        weights: (point,) w.
        plane: (1 + parameter,) b and a.
    """

    points: Tensor
    weights: Tensor
    plane: Tensor

    def __call__(self, population: Tensor) -> Tensor:
        """s(x), (population,), for points (population, parameter); in standard deviations of the losses it was fitted to."""
        return distances(population, self.points) ** 3 @ self.weights + with_ones(population) @ self.plane


def fit_surrogate(points: Tensor, losses: Tensor) -> CubicSurrogate:
    """Fit the losses, those above the median flattened to it: the steep outskirts would bend the model where it matters.

    Args:
        points: (point, parameter) float64.
        losses: (point,) float64; those at `PENALTY` count as the median of the others.

    Returns:
        A model of (loss - mean) / standard deviation.
    """
    known = losses[losses < PENALTY]
    flattened = losses.clamp(max=known.median()) if len(known) else torch.zeros_like(losses)
    spread = flattened.std(correction=0)
    values = (flattened - flattened.mean()) / spread.clamp(min=1e-300)
    cubes = distances(points, points) ** 3
    ridge = (RIDGE * cubes.median()).clamp(min=LEAST_RIDGE)
    count, width = len(points), points.shape[1] + 1
    matrix = torch.zeros(count + width, count + width, dtype=points.dtype)
    matrix[:count, :count] = cubes + ridge * torch.eye(count, dtype=points.dtype)
    matrix[:count, count:] = with_ones(points)
    matrix[count:, :count] = with_ones(points).T
    # Fewer points than parameters leave the plane undetermined; a touch of damping picks the flattest.
    matrix[count:, count:] = -LEAST_RIDGE * torch.eye(width, dtype=points.dtype)
    solution = torch.linalg.solve(matrix, torch.cat([values, values.new_zeros(width)]))
    return CubicSurrogate(points, solution[:count], solution[count:])


def distances(first: Tensor, second: Tensor) -> Tensor:
    """Euclidean distances (first, second), exact also for points that almost coincide."""
    return torch.cdist(first, second, compute_mode="donot_use_mm_for_euclid_dist")


def with_ones(points: Tensor) -> Tensor:
    """The rows (1, x)."""
    return torch.cat([points.new_ones(len(points), 1), points], dim=1)
