"""L-BFGS (Nocedal and Wright 2006, algorithm 7.4), projected onto the unit cube, for many starts at once."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cloudfit.optimisers.base import StopReason
from render.errors import ParameterError

SUFFICIENT_DECREASE = 1e-4
"""Share of the decrease that the gradient promises (Armijo's rule)."""

LEAST_CURVATURE = 1e-10
"""Cosine between a step and the change of the gradient below which the pair says nothing about the curvature."""


@dataclass(frozen=True)
class LbfgsState:
    """Where the descents stand; a descent that has ended is not asked again.

    Args:
        points: (start, parameter).
        losses: (start,), infinite before the first evaluation.
        gradient: (start, parameter).
        directions: (start, parameter) of the lines that are being searched.
        lengths: (start,) of the next trial along them.
        steps: (start, memory, parameter) last differences of points, the latest last; zero where there are none yet.
        changes: (start, memory, parameter) differences of gradients that belong to them.
        going: (start,) bool.
        iterations: number of batches evaluated.
    """

    points: Tensor
    losses: Tensor
    gradient: Tensor
    directions: Tensor
    lengths: Tensor
    steps: Tensor
    changes: Tensor
    going: Tensor
    iterations: int = 0


@dataclass(frozen=True)
class Lbfgs:
    """Hyper-parameters of L-BFGS with a backtracking line search; each batch is one trial of every descent that goes on.

        x <- P(x - t H g),   H from the last steps s and changes y of the gradient by the two-loop recursion

    P moves a point into the unit cube; parameters that the gradient would push out of it stand still. The lines halve t from 1
    until Armijo's rule holds.

    Args:
        memory: pairs of steps and changes that are kept.
        first_step: length of the first step of a descent, whose curvature is not known yet.
        tolerance: step in every parameter below which a descent has converged.
        largest_iterations: batches after which it ends.

    Raises:
        ParameterError: when a number is outside its domain.
    """

    memory: int = 8
    first_step: float = 0.1
    tolerance: float = 1e-5
    largest_iterations: int = 300

    def __post_init__(self) -> None:
        if not (
            self.memory >= 1 and 0.0 < self.first_step <= 1.0 and self.tolerance > 0 and self.largest_iterations >= 1
        ):
            raise ParameterError(
                "expected a memory of at least one pair, a first_step in 0..1, a tolerance > 0 and at least one iteration, got "
                f"{self.memory}, {self.first_step}, {self.tolerance} and {self.largest_iterations}"
            )

    def init(self, starts: Tensor) -> LbfgsState:
        """Before the first gradients: the first trial of each line is the start itself."""
        count, dimension = starts.shape
        none = torch.zeros(count, self.memory, dimension, dtype=starts.dtype)
        return LbfgsState(
            points=starts,
            losses=torch.full((count,), torch.inf, dtype=starts.dtype),
            gradient=torch.zeros_like(starts),
            directions=torch.zeros_like(starts),
            lengths=torch.ones(count, dtype=starts.dtype),
            steps=none,
            changes=none,
            going=torch.ones(count, dtype=torch.bool),
        )

    def ask(self, state: LbfgsState) -> Tensor:
        """The next trial of every descent that goes on."""
        return self._trials(state)[state.going]

    def tell(self, state: LbfgsState, losses: Tensor, gradient: Tensor) -> LbfgsState:
        """Accept or shorten the steps, and turn where they were accepted."""
        going = state.going
        trials, tried = self._trials(state), state.losses.clone()
        slopes = state.gradient.clone()
        tried[going], slopes[going] = losses, gradient
        step = trials - state.points
        promised = -(step * state.gradient).sum(dim=1)
        accepted = going & (tried <= state.losses - SUFFICIENT_DECREASE * promised.clamp(min=0.0))
        remember = accepted & state.losses.isfinite()
        steps, changes = remember_pairs(state.steps, state.changes, step, slopes - state.gradient, remember)
        turned = replace(
            state,
            points=torch.where(accepted[:, None], trials, state.points),
            losses=torch.where(accepted, tried, state.losses),
            gradient=torch.where(accepted[:, None], slopes, state.gradient),
            steps=steps,
            changes=changes,
            iterations=state.iterations + 1,
        )
        directions = torch.where(accepted[:, None], self._directions(turned), state.directions)
        lengths = torch.where(accepted, 1.0, state.lengths / 2)
        reach = lengths * directions.abs().amax(dim=1)
        small = remember & (step.abs().amax(dim=1) < self.tolerance)
        still_going = going & (reach >= self.tolerance) & ~small
        return replace(turned, directions=directions, lengths=lengths, going=still_going)

    def stop_reason(self, state: LbfgsState) -> StopReason | None:
        """When all descents have converged, or after too many batches."""
        if not bool(state.going.any()):
            return StopReason.CONVERGED
        return StopReason.ITERATIONS if state.iterations >= self.largest_iterations else None

    def _trials(self, state: LbfgsState) -> Tensor:
        return (state.points + state.lengths[:, None] * state.directions).clamp(0.0, 1.0)

    def _directions(self, state: LbfgsState) -> Tensor:
        """(start, parameter) -H g, against the gradient at least; zero in parameters that rest at a bound."""
        x, g = state.points, state.gradient
        resting = ((x <= 0.0) & (g > 0.0)) | ((x >= 1.0) & (g < 0.0))
        g = g.masked_fill(resting, 0.0)
        directions = -multiply_inverse_hessian(g, state.steps, state.changes).masked_fill(resting, 0.0)
        steepest = -self.first_step * g / g.abs().amax(dim=1, keepdim=True).clamp(min=1e-300)
        knows = (state.steps[:, -1] != 0.0).any(dim=1) & ((directions * g).sum(dim=1) < 0.0)
        return torch.where(knows[:, None], directions, steepest)


def remember_pairs(
    steps: Tensor, changes: Tensor, step: Tensor, change: Tensor, chosen: Tensor
) -> tuple[Tensor, Tensor]:
    """Append pairs in the chosen rows whose curvature is positive, in place of the oldest; all as of `LbfgsState`."""
    curvature = (step * change).sum(dim=1)
    useful = chosen & (curvature > LEAST_CURVATURE * step.norm(dim=1) * change.norm(dim=1))
    row = useful[:, None, None]
    return (
        torch.where(row, torch.cat([steps[:, 1:], step[:, None]], dim=1), steps),
        torch.where(row, torch.cat([changes[:, 1:], change[:, None]], dim=1), changes),
    )


def multiply_inverse_hessian(gradient: Tensor, steps: Tensor, changes: Tensor) -> Tensor:
    """H g by the two-loop recursion, scaled by s y / y y of the latest pair; g itself where there are no pairs.

    Args:
        gradient: (start, parameter).
        steps: (start, memory, parameter) s, the latest last; zero where there are none.
        changes: (start, memory, parameter) y.

    Returns:
        (start, parameter).
    """
    curvature = (steps * changes).sum(dim=2)
    weight = torch.where(curvature > 0.0, 1.0 / curvature.clamp(min=1e-300), 0.0)
    product, shares = gradient, []
    for pair in reversed(range(steps.shape[1])):
        share = weight[:, pair] * (steps[:, pair] * product).sum(dim=1)
        shares.append(share)
        product = product - share[:, None] * changes[:, pair]
    length = (changes[:, -1] ** 2).sum(dim=1)
    scale = torch.where(length > 0.0, curvature[:, -1] / length.clamp(min=1e-300), 1.0)
    product = scale[:, None] * product
    for pair in range(steps.shape[1]):
        back = weight[:, pair] * (changes[:, pair] * product).sum(dim=1)
        product = product + (shares.pop() - back)[:, None] * steps[:, pair]
    return product
