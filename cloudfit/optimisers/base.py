"""What every optimiser has in common: budgets, reasons to stop, and the log of evaluations.

All optimisers minimise a batched objective over the unit cube. Whatever ends a run (a budget, an interruption, an
exception of the objective), the best point so far is returned together with the reason.
"""

import enum
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Protocol, TypeVar, runtime_checkable

import torch
from torch import Tensor

from render.errors import ParameterError

Objective = Callable[[Tensor], Tensor]
"""(population, parameter) float32 in the unit cube -> (population,) losses, to be made small."""


@runtime_checkable
class DifferentiableObjective(Protocol):
    """An objective that knows its slope; both methods take points of the unit cube."""

    def __call__(self, population: Tensor) -> Tensor:
        """Losses (population,) of the points (population, parameter)."""
        ...

    def with_gradient(self, population: Tensor) -> tuple[Tensor, Tensor]:
        """Losses (population,), and the derivative of each with respect to its own point, (population, parameter)."""
        ...


Progress = Callable[[int, int, float], None]
"""Called with (iterations, evaluations, best loss) after every batch of evaluations."""

PENALTY = 1e9
"""Loss of a point whose loss is NaN or infinite: finite, because some methods crash on infinity, and never the best."""


class StopReason(enum.Enum):
    """Why a run ended; the value is the sentence to show."""

    TARGET = "The target loss was reached."
    STAGNATION = "The best loss did not improve for the allowed number of iterations."
    ITERATIONS = "The largest number of iterations was reached."
    EVALUATIONS = "The budget of evaluations was spent."
    SECONDS = "The budget of time was spent."
    CONVERGED = "The steps of the method became smaller than its tolerance."
    INTERRUPTED = "The run was interrupted; the best point so far was kept."
    FAILED = "The run failed; the best point so far was kept."


@dataclass(frozen=True)
class Budget:
    """What a run may spend; None means without limit.

    Args:
        evaluations: largest number of points evaluated.
        seconds: time after which no new batch of evaluations begins [s].
        target: loss at which the run ends.

    Raises:
        ParameterError: when a limit leaves nothing to do or is not a number.
    """

    evaluations: int | None = None
    seconds: float | None = None
    target: float | None = None

    def __post_init__(self) -> None:
        if self.evaluations is not None and self.evaluations < 1:
            raise ParameterError(f"expected a budget of at least one evaluation, got {self.evaluations}")
        if self.seconds is not None and not self.seconds > 0:
            raise ParameterError(f"expected a budget of more than 0 s, got {self.seconds} s")
        if self.target is not None and math.isnan(self.target):
            raise ParameterError("expected a number as the target loss, got NaN")


@dataclass(frozen=True)
class OptimiserResult:
    """Outcome of a run.

    Args:
        best: (parameter,) best point evaluated, float32 in the unit cube.
        best_loss: its loss; `PENALTY` when no point had a finite loss.
        evaluations: number of points evaluated.
        iterations: number of batches evaluated.
        seconds: duration of the run [s].
        stop_reason: why it ended.
        history: (iteration,) best loss after each batch, float64.
        evaluated: (evaluation, parameter) every point in the order of evaluation, float32.
        losses: (evaluation,) their losses, float64, not finite ones replaced by `PENALTY`.
        times: (evaluation,) when each loss was known, since the start of the run, float64 [s].
        objective_seconds: the part of `seconds` that was spent inside the objective [s].
        message: what went wrong, where something did.
    """

    best: Tensor
    best_loss: float
    evaluations: int
    iterations: int
    seconds: float
    stop_reason: StopReason
    history: Tensor
    evaluated: Tensor
    losses: Tensor
    times: Tensor
    objective_seconds: float
    message: str = ""


def pool_results(results: Sequence[OptimiserResult]) -> OptimiserResult:
    """One result of runs on the same objective, one after the other; the reason to stop is that of the last."""
    best = min(results, key=lambda result: result.best_loss)
    began = accumulate((result.seconds for result in results[:-1]), initial=0.0)
    return OptimiserResult(
        best=best.best,
        best_loss=best.best_loss,
        evaluations=sum(result.evaluations for result in results),
        iterations=sum(result.iterations for result in results),
        seconds=sum(result.seconds for result in results),
        stop_reason=results[-1].stop_reason,
        history=torch.cat([result.history for result in results]).cummin(dim=0).values,
        evaluated=torch.cat([result.evaluated for result in results]),
        losses=torch.cat([result.losses for result in results]),
        times=torch.cat([result.times + start for result, start in zip(results, began, strict=True)]),
        objective_seconds=sum(result.objective_seconds for result in results),
        message=results[-1].message,
    )


class Minimiser(Protocol):
    """Anything that minimises: hyper-parameters only; a run leaves no trace in it."""

    def minimise(
        self,
        objective: Objective,
        dimension: int,
        budget: Budget,
        seed: int,
        on_progress: Progress | None = None,
        start: Tensor | None = None,
    ) -> OptimiserResult:
        """Search the unit cube for the smallest loss.

        Args:
            objective: (population, parameter) -> (population,).
            dimension: number of parameters.
            budget: what may be spent.
            seed: of all random choices, 0 or more; the same seed gives the same result.
            on_progress: called after every batch.
            start: (parameter,) a good point to begin with; methods that cannot use one ignore it.

        Returns:
            the best point with its record.
        """
        ...


class BudgetSpent(Exception):
    """Ends a search from inside `EvaluationLog.evaluate`: not an error but the ordinary end of a run."""

    def __init__(self, reason: StopReason) -> None:
        super().__init__(reason.value)
        self.reason = reason


def penalise(losses: Tensor) -> Tensor:
    """Losses in float64 with `PENALTY` for those that are NaN, infinite or beyond it: the only place that does so."""
    losses = losses.detach().double().cpu()
    return torch.where(losses.isfinite(), losses, PENALTY).clamp(max=PENALTY)


def require_gradient(objective: Objective) -> DifferentiableObjective:
    """The objective as one that knows its slope.

    Raises:
        ParameterError: when it does not.
    """
    if not isinstance(objective, DifferentiableObjective):
        raise ParameterError(
            "this method follows the gradient, and the objective has none; choose a differentiable loss or another method"
        )
    return objective


Outcome = TypeVar("Outcome")


class EvaluationLog:
    """The record of one run and the guard of its budget: the only thing that changes while an optimiser works."""

    def __init__(self, objective: Objective, dimension: int, budget: Budget, on_progress: Progress | None) -> None:
        self.dimension = dimension
        self._objective = objective
        self._budget = budget
        self._on_progress = on_progress
        self._began = time.perf_counter()
        # One append per batch: an interruption between two statements leaves a consistent record.
        self._batches: list[tuple[Tensor, Tensor, float]] = []
        self._objective_seconds = 0.0
        self.evaluations = 0
        self.best_loss = math.inf

    @property
    def is_empty(self) -> bool:
        """Whether nothing has been evaluated yet, so that there is no result to return."""
        return not self._batches

    def evaluate(self, population: Tensor) -> Tensor:
        """Losses of the points, recorded.

        Args:
            population: (population, parameter); clamped to the unit cube and rounded to float32 first.

        Returns:
            (population,) finite, float64.

        Raises:
            BudgetSpent: when the budget is spent, before or after this batch; a batch that does not fit is cut.
            ParameterError: when the objective returns another shape.
        """
        points = self._admit(population)
        losses = self._measure(self._objective, points)
        return self._record(points, losses, len(population))

    def evaluate_with_gradient(self, population: Tensor) -> tuple[Tensor, Tensor]:
        """Losses of the points, recorded, and their slopes; one evaluation per point.

        Args:
            population: (population, parameter), as of `evaluate`.

        Returns:
            (population,) losses and (population, parameter) gradients, float64; where a loss or a slope is not finite, the
            slope is 0.

        Raises:
            BudgetSpent: as `evaluate` does.
            ParameterError: when the objective has no gradient, or one of another shape.
        """
        objective = require_gradient(self._objective)
        points = self._admit(population)
        losses, gradient = self._measure(objective.with_gradient, points)
        if gradient.shape != points.shape:
            raise ParameterError(f"expected a gradient of shape {tuple(points.shape)}, got {tuple(gradient.shape)}")
        gradient = gradient.detach().double().cpu()
        known = losses.detach().cpu().isfinite()[:, None] & gradient.isfinite()
        return self._record(points, losses, len(population)), torch.where(known, gradient, 0.0)

    def _admit(self, population: Tensor) -> Tensor:
        """The points that the budget allows, in the unit cube, float32."""
        self._require_budget()
        allowed = len(population)
        if self._budget.evaluations is not None:
            allowed = min(allowed, self._budget.evaluations - self.evaluations)
        return population[:allowed].detach().to(device="cpu", dtype=torch.float32).clamp(0.0, 1.0)

    def _measure(self, objective: Callable[[Tensor], Outcome], points: Tensor) -> Outcome:
        began = time.perf_counter()
        outcome = objective(points.clone())
        self._objective_seconds += time.perf_counter() - began
        return outcome

    def _record(self, points: Tensor, losses: Tensor, asked: int) -> Tensor:
        """Keep the losses of one batch, and end the run when it has what it wanted or may not have all it asked for."""
        if losses.shape != (len(points),):
            raise ParameterError(
                f"the objective returned losses of shape {tuple(losses.shape)} for points {tuple(points.shape)}; "
                f"expected (population,) = ({len(points)},)"
            )
        losses = penalise(losses)
        self._batches.append((points, losses, time.perf_counter() - self._began))
        self.evaluations += len(points)
        self.best_loss = min(self.best_loss, float(losses.min()))
        if self._on_progress is not None:
            self._on_progress(len(self._batches), self.evaluations, self.best_loss)
        if self._budget.target is not None and self.best_loss <= self._budget.target:
            raise BudgetSpent(StopReason.TARGET)
        if len(points) < asked:
            raise BudgetSpent(StopReason.EVALUATIONS)
        return losses

    def result(self, stop_reason: StopReason, message: str = "") -> OptimiserResult:
        """Outcome so far; at least one batch must have been evaluated."""
        evaluated = torch.cat([points for points, _, _ in self._batches])
        losses = torch.cat([losses for _, losses, _ in self._batches])
        times = [torch.full((len(losses),), known, dtype=torch.float64) for _, losses, known in self._batches]
        best = int(losses.argmin())
        best_of_batches = torch.stack([losses.min() for _, losses, _ in self._batches])
        if not message and float(losses[best]) == PENALTY:
            message = "no point had a finite loss"
        return OptimiserResult(
            best=evaluated[best],
            best_loss=float(losses[best]),
            evaluations=len(losses),
            iterations=len(self._batches),
            seconds=time.perf_counter() - self._began,
            stop_reason=stop_reason,
            history=best_of_batches.cummin(dim=0).values,
            evaluated=evaluated,
            losses=losses,
            times=torch.cat(times),
            objective_seconds=self._objective_seconds,
            message=message,
        )

    def _require_budget(self) -> None:
        if self._budget.evaluations is not None and self.evaluations >= self._budget.evaluations:
            raise BudgetSpent(StopReason.EVALUATIONS)
        # A time budget that is over before the first batch still buys one: a result needs a point.
        seconds = math.inf if self._budget.seconds is None or self.is_empty else self._budget.seconds
        if time.perf_counter() - self._began >= seconds:
            raise BudgetSpent(StopReason.SECONDS)


def run_logged(
    search: Callable[[EvaluationLog], StopReason],
    objective: Objective,
    dimension: int,
    budget: Budget,
    on_progress: Progress | None = None,
) -> OptimiserResult:
    """Run a search on a fresh log and turn every way in which it can end into a result.

    Args:
        search: evaluates points through the log until it has a reason of its own to stop.
        objective: (population, parameter) -> (population,).
        dimension: number of parameters.
        budget: what may be spent.
        on_progress: called after every batch.

    Returns:
        the best point with its record.

    Raises:
        ParameterError: when there is no parameter.
        Exception: that of the objective, and KeyboardInterrupt, when nothing had been evaluated yet.
    """
    if dimension < 1:
        raise ParameterError(f"expected at least one parameter to search, got {dimension}")
    log = EvaluationLog(objective, dimension, budget, on_progress)
    try:
        return log.result(search(log))
    except BudgetSpent as end:
        return log.result(end.reason)
    except KeyboardInterrupt:
        if log.is_empty:
            raise
        return log.result(StopReason.INTERRUPTED)
    except Exception as error:
        if log.is_empty:
            raise
        return log.result(StopReason.FAILED, f"{type(error).__name__}: {error}")


def seeded_generator(seed: int) -> torch.Generator:
    """Generator of a run.

    Raises:
        ParameterError: when the seed is negative.
    """
    if seed < 0:
        raise ParameterError(f"expected a seed of 0 or more, got {seed}")
    return torch.Generator().manual_seed(seed)


def check_start(start: Tensor | None, dimension: int) -> Tensor | None:
    """Starting point in float64, moved into the unit cube.

    Raises:
        ParameterError: when its shape is not (parameter,) or it is not finite.
    """
    if start is None:
        return None
    if start.shape != (dimension,) or not bool(start.isfinite().all()):
        raise ParameterError(f"expected a finite start of shape ({dimension},), got {start} of {tuple(start.shape)}")
    return start.detach().double().cpu().clamp(0.0, 1.0)
