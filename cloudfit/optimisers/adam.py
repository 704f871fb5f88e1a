"""Adam (Kingma and Ba 2015, algorithm 1), projected onto the unit cube, for many starts at once."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cloudfit.optimisers.base import StopReason
from render.errors import ParameterError

EPSILON = 1e-8


@dataclass(frozen=True)
class AdamState:
    """Where the descents stand.

    Args:
        points: (start, parameter).
        mean: (start, parameter) m, decaying mean of the gradients.
        square: (start, parameter) v, decaying mean of their squares.
        iterations: number of steps made.
    """

    points: Tensor
    mean: Tensor
    square: Tensor
    iterations: int = 0


@dataclass(frozen=True)
class Adam:
    """Hyper-parameters of Adam with a step that falls like half a cosine.

        m <- b1 m + (1 - b1) g,  v <- b2 v + (1 - b2) g^2,  x <- P(x - a_t m / (1 - b1^t) / (sqrt(v / (1 - b2^t)) + 1e-8))

    a_t = a (1 + cos(pi t / T)) / 2; P moves a point into the unit cube.

    Args:
        step: a, first step in the unit cube.
        mean_decay: b1.
        square_decay: b2; shorter than in the article, for runs of hundreds of steps.
        largest_iterations: T.

    Raises:
        ParameterError: when a number is outside its domain.
    """

    step: float = 0.05
    mean_decay: float = 0.9
    square_decay: float = 0.99
    largest_iterations: int = 120

    def __post_init__(self) -> None:
        decays = 0.0 <= self.mean_decay < 1.0 and 0.0 <= self.square_decay < 1.0
        if not (0.0 < self.step <= 1.0 and decays and self.largest_iterations >= 1):
            raise ParameterError(
                "expected a step in 0..1, decays in 0..1 and at least one iteration, got "
                f"{self.step}, {self.mean_decay}, {self.square_decay} and {self.largest_iterations}"
            )

    def init(self, starts: Tensor) -> AdamState:
        """At rest."""
        return AdamState(starts, torch.zeros_like(starts), torch.zeros_like(starts))

    def ask(self, state: AdamState) -> Tensor:
        """Where the descents stand."""
        return state.points

    def tell(self, state: AdamState, losses: Tensor, gradient: Tensor) -> AdamState:
        """One step of each."""
        number = state.iterations + 1
        mean = self.mean_decay * state.mean + (1 - self.mean_decay) * gradient
        square = self.square_decay * state.square + (1 - self.square_decay) * gradient**2
        step = self.step * (1 + math.cos(math.pi * state.iterations / self.largest_iterations)) / 2
        unbiased = mean / (1 - self.mean_decay**number)
        scale = (square / (1 - self.square_decay**number)).sqrt() + EPSILON
        points = (state.points - step * unbiased / scale).clamp(0.0, 1.0)
        return replace(state, points=points, mean=mean, square=square, iterations=number)

    def stop_reason(self, state: AdamState) -> StopReason | None:
        """After the last step, when the points of the last but one have been evaluated."""
        return StopReason.ITERATIONS if state.iterations >= self.largest_iterations else None
