"""Directions of the sphere with weights that integrate harmonics exactly, turned at random."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from render.spherical_harmonics import degrees_of_harmonics, evaluate_harmonics


@dataclass(frozen=True, eq=False)
class DirectionSet:
    """Directions of a product rule: Gauss-Legendre in the cosine of the polar angle, evenly in azimuth.

    Each ring of one polar angle is cut in two, every other direction first; the first halves of all rings come before the second ones, each
    shifted in azimuth against the next, like the squares of one colour on a chess board.

    Args:
        direction: unit vectors `(direction, 3)`.
        harmonics: at them `(direction, harmonic)`, see `evaluate_harmonics`.
        projection: of values at the directions on the harmonics `(harmonic, direction)`; its product with `harmonics` is one.
        degree: largest of the harmonics.
        place: number of each one's ring, and of its azimuth in it `(direction, 2)`.
    """

    direction: Tensor
    harmonics: Tensor
    projection: Tensor
    degree: int
    place: Tensor

    def halves(self, degree: int) -> tuple["DirectionSet", "DirectionSet"]:
        """Every other direction, and the rest, with the harmonics up to a smaller degree and the least squares that give them back.

        Harmonics whose degrees add up to no more than the whole set's are orthogonal over each half; those beyond by one nearly so.
        """
        middle = len(self.direction) // 2
        first, second = (self._part(rows, degree) for rows in (slice(None, middle), slice(middle, None)))
        return first, second

    def _part(self, rows: slice, degree: int) -> "DirectionSet":
        kept = degrees_of_harmonics(self.degree, odd=True) <= degree
        harmonics, weights = self.harmonics[rows, kept], self.projection[0, rows].double()
        weighted = harmonics.double().T * weights
        projection = torch.linalg.solve(weighted @ harmonics.double(), weighted).float()
        return DirectionSet(self.direction[rows], harmonics, projection, degree, self.place[rows])


def turned_directions(degree: int, uniform: Tensor) -> DirectionSet:
    """Directions, 2 (degree + 1)^2 of them, that integrate products of harmonics up to a degree exactly.

    Args:
        degree: largest l of the harmonics.
        uniform: three random numbers in 0..1, which turn the sphere evenly (Shoemake 1992, "Uniform random rotations").
    """
    cosine, weight = (torch.from_numpy(values) for values in np.polynomial.legendre.leggauss(degree + 1))
    count = 2 * (degree + 1)
    azimuth = torch.arange(count, dtype=torch.float64) * (2.0 * math.pi / count)
    sine = (1.0 - cosine**2).sqrt()
    plain = torch.stack(
        [sine[:, None] * azimuth.cos(), sine[:, None] * azimuth.sin(), cosine[:, None].expand(-1, count)], dim=-1
    )
    place = torch.cartesian_prod(torch.arange(degree + 1), torch.arange(count))
    order = (place.sum(1) % 2).argsort(stable=True)
    direction = plain.reshape(-1, 3)[order] @ _rotation(uniform.double()).T
    harmonics = evaluate_harmonics(direction, degree)
    weights = (weight * (2.0 * math.pi / count))[place[order, 0]]
    projection = (harmonics * weights[:, None]).T.float().contiguous()
    return DirectionSet(direction.float(), harmonics.float(), projection, degree, place[order])


def _rotation(uniform: Tensor) -> Tensor:
    """Matrix of the unit quaternion that three uniform numbers give `(3, 3)`."""
    first, second = 2.0 * math.pi * uniform[1], 2.0 * math.pi * uniform[2]
    low, high = (1.0 - uniform[0]).sqrt(), uniform[0].sqrt()
    x, y, z, w = low * first.sin(), low * first.cos(), high * second.sin(), high * second.cos()
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row) for row in rows])
