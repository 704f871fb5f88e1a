"""Steepest descent as the paper compares it with the genetic algorithm: from one start, against a gradient of differences."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cloudfit.optimisers.base import StopReason
from render.errors import ParameterError

SUFFICIENT_DECREASE = 1e-4
"""Share of the decrease that the gradient promises (Armijo's rule)."""


@dataclass(frozen=True)
class DescentState:
    """Where the descent stands; it measures the slope and searches along it by turns.

    Args:
        point: (parameter,) float64.
        loss: of it; infinite before the first evaluation.
        slope: (parameter,) gradient by differences, while a line is being searched.
        iterations: number of slopes measured.
        converged: whether no step along the last slope was good enough.
    """

    point: Tensor
    loss: float
    slope: Tensor | None = None
    iterations: int = 0
    converged: bool = False


@dataclass(frozen=True)
class SteepestDescent:
    """Projected steepest descent with central differences and a backtracking line search, each one batch of evaluations.

        x <- P(x - t d),  d = g / max |g|,  t = the largest of s, s/2, s/4, ... with f(x) - f(P(x - t d)) >= 1e-4 g (x - P(x - t d))

    P moves a point into the unit cube; g has (f(x + h e) - f(x - h e)) / 2h in each parameter. The width h of the differences is
    wide, because the losses of histograms jump on small scales.

    Args:
        difference: h, in the unit cube.
        longest_step: s.
        halvings: how often s is halved before the method gives up.
        largest_iterations: slopes after which it ends.

    Raises:
        ParameterError: when a number is outside its domain.
    """

    difference: float = 0.01
    longest_step: float = 0.25
    halvings: int = 11
    largest_iterations: int = 200

    def __post_init__(self) -> None:
        if not (0.0 < self.difference <= 0.5 and 0.0 < self.longest_step <= 1.0):
            raise ParameterError(
                f"expected a difference in 0..0.5 and a longest_step in 0..1, got {self.difference} and {self.longest_step}"
            )
        if self.halvings < 0 or self.largest_iterations < 1:
            raise ParameterError(
                "expected halvings of 0 or more and at least one iteration, got "
                f"{self.halvings} and {self.largest_iterations}"
            )

    def init(self, dimension: int, generator: torch.Generator, start: Tensor | None = None) -> DescentState:
        """The start, or a random point."""
        point = torch.rand(dimension, generator=generator, dtype=torch.float64) if start is None else start
        return DescentState(point, float("inf"))

    def ask(self, state: DescentState) -> tuple[Tensor, DescentState]:
        """The point and its neighbours in every parameter, or the points of a line."""
        return (self._neighbours(state.point) if state.slope is None else self._line(state.point, state.slope)), state

    def tell(self, state: DescentState, population: Tensor, losses: Tensor) -> DescentState:
        """Take the slope from the neighbours, or the longest step that is good enough from the line."""
        if state.slope is None:
            before, after = population[1:].double().chunk(2)
            lower, upper = losses[1:].chunk(2)
            # At a bound the difference is one-sided: the width is what was left of it.
            slope = (upper - lower) / (after - before).sum(dim=1)
            return replace(state, loss=float(losses[0]), slope=slope, iterations=state.iterations + 1)
        promised = ((state.point - population) * state.slope).sum(dim=1)
        good = (promised > 0) & (state.loss - losses >= SUFFICIENT_DECREASE * promised)
        if not bool(good.any()):
            return replace(state, converged=True)
        return replace(state, point=population[int(good.int().argmax())], slope=None)

    def stop_reason(self, state: DescentState) -> StopReason | None:
        """Converged, or too many iterations."""
        if state.converged:
            return StopReason.CONVERGED
        if state.iterations >= self.largest_iterations and state.slope is None:
            return StopReason.ITERATIONS
        return None

    def _neighbours(self, point: Tensor) -> Tensor:
        """(1 + 2 parameters, parameter): the point, those below it, those above it."""
        steps = self.difference * torch.eye(len(point), dtype=torch.float64)
        return torch.cat([point[None], point - steps, point + steps]).clamp(0.0, 1.0)

    def _line(self, point: Tensor, slope: Tensor) -> Tensor:
        """(1 + halvings, parameter): ever shorter steps against the slope."""
        lengths = self.longest_step * 0.5 ** torch.arange(self.halvings + 1, dtype=torch.float64)
        direction = slope / slope.abs().max().clamp(min=1e-300)
        return (point - lengths[:, None] * direction).clamp(0.0, 1.0)
