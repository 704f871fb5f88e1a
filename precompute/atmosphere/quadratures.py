"""With how many points, and by which rules, the integrals of an atmosphere are taken."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from render.errors import ParameterError


def _trapezoid(count: int) -> tuple[np.ndarray, np.ndarray]:
    weights = np.full(count + 1, 1.0 / count)
    weights[[0, -1]] *= 0.5
    return np.arange(count + 1) / count, weights


def _midpoint(count: int) -> tuple[np.ndarray, np.ndarray]:
    return (np.arange(count) + 0.5) / count, np.full(count, 1.0 / count)


def _gauss_legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * (nodes + 1.0), 0.5 * weights


RULES: dict[str, Callable[[int], tuple[np.ndarray, np.ndarray]]] = {
    "trapezoid": _trapezoid,
    "midpoint": _midpoint,
    "gauss_legendre": _gauss_legendre,
}
"""Rules by name: positions in 0..1 and weights that sum to one. The count is that of intervals; of points for Gauss-Legendre."""


@dataclass(frozen=True)
class LineRule:
    """A rule for integrals over an interval.

    Args:
        rule: a name of `RULES`.
        count: of intervals, or points.

    Raises:
        ParameterError: if there is no such rule, or the count is not positive.
    """

    rule: str
    count: int

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise ParameterError(f"no quadrature is called {self.rule!r}; there are {', '.join(RULES)}")
        if self.count < 1:
            raise ParameterError(f"a quadrature needs at least one interval, not {self.count}")

    def nodes(self) -> tuple[Tensor, Tensor]:
        """Positions in 0..1 and weights that sum to one, each `(node,)`, float64."""
        positions, weights = RULES[self.rule](self.count)
        return torch.from_numpy(positions), torch.from_numpy(weights)


@dataclass(frozen=True)
class DirectionRule:
    """A rule for integrals over directions: the product of one over the angle to the zenith and one around it.

    Args:
        polar: over the angle to the zenith.
        azimuth: around the zenith.
    """

    polar: LineRule
    azimuth: LineRule

    def polar_nodes(self, largest: float) -> tuple[Tensor, Tensor]:
        """Angles to the zenith, 0..`largest` [rad], and their share of solid angle per azimuth, sin(theta) d theta, each `(polar,)`."""
        positions, weights = self.polar.nodes()
        angles = largest * positions
        return angles, largest * weights * torch.sin(angles)

    def azimuth_nodes(self) -> tuple[Tensor, Tensor]:
        """Azimuths, 0..2 pi [rad], and their weights [rad], each `(azimuth,)`."""
        positions, weights = self.azimuth.nodes()
        return 2.0 * math.pi * positions, 2.0 * math.pi * weights


@dataclass(frozen=True)
class Quadratures:
    """The rules of all stages; the defaults are those of Bruneton's reference, `PARITY`.

    Args:
        transmittance: along a ray to the top of the air.
        single_scattering, multiple_scattering: along a ray to the end of the air.
        scattering_density: over the directions of incident light, the polar angle from the zenith to the nadir.
        irradiance: over the directions of the sky, the polar angle from the zenith to the horizontal.
    """

    transmittance: LineRule = LineRule("trapezoid", 500)
    single_scattering: LineRule = LineRule("trapezoid", 50)
    multiple_scattering: LineRule = LineRule("trapezoid", 50)
    scattering_density: DirectionRule = DirectionRule(LineRule("midpoint", 16), LineRule("midpoint", 32))
    irradiance: DirectionRule = DirectionRule(LineRule("midpoint", 16), LineRule("midpoint", 64))


PARITY = Quadratures()
"""The rules of Bruneton's reference."""
