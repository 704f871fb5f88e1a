"""What every optimiser has in common: budgets, reasons to stop, the log of evaluations and the loop around ask and tell.

All optimisers minimise a batched objective over the unit cube. Whatever ends a run (a budget, an interruption, an
exception of the objective), the best point so far is returned together with the reason.
"""

import enum
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import torch
from torch import Tensor

from render.errors import ParameterError

Objective = Callable[[Tensor], Tensor]
"""(population, parameter) float32 in the unit cube -> (population,) losses, to be made small."""

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
    message: str = ""


def pool_results(results: Sequence[OptimiserResult]) -> OptimiserResult:
    """One result of runs on the same objective, one after the other; the reason to stop is that of the last."""
    best = min(results, key=lambda result: result.best_loss)
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


State = TypeVar("State")


class AskTellOptimiser(Protocol[State]):
    """A population method over a frozen state; every step is a pure function of the state."""

    def init(self, dimension: int, generator: torch.Generator, start: Tensor | None = None) -> State:
        """Return the state before the first evaluation, with `start` (parameter,) among the first population if given."""
        ...

    def ask(self, state: State) -> tuple[Tensor, State]:
        """Return the points to evaluate, (population, parameter) in the unit cube."""
        ...

    def tell(self, state: State, population: Tensor, losses: Tensor) -> State:
        """Take the finite losses (population,) of the points of the last `ask`."""
        ...

    def stop_reason(self, state: State) -> StopReason | None:
        """Return why the method itself would end now, or None."""
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


class EvaluationLog:
    """The record of one run and the guard of its budget: the only thing that changes while an optimiser works."""

    def __init__(self, objective: Objective, dimension: int, budget: Budget, on_progress: Progress | None) -> None:
        self.dimension = dimension
        self._objective = objective
        self._budget = budget
        self._on_progress = on_progress
        self._began = time.perf_counter()
        # One append per batch: an interruption between two statements leaves a consistent record.
        self._batches: list[tuple[Tensor, Tensor]] = []
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
        self._require_budget()
        allowed = len(population)
        if self._budget.evaluations is not None:
            allowed = min(allowed, self._budget.evaluations - self.evaluations)
        points = population[:allowed].detach().to(device="cpu", dtype=torch.float32).clamp(0.0, 1.0)
        losses = self._objective(points.clone())
        if losses.shape != (allowed,):
            raise ParameterError(
                f"the objective returned losses of shape {tuple(losses.shape)} for points {tuple(points.shape)}; "
                f"expected (population,) = ({allowed},)"
            )
        losses = penalise(losses)
        self._batches.append((points, losses))
        self.evaluations += allowed
        self.best_loss = min(self.best_loss, float(losses.min()))
        if self._on_progress is not None:
            self._on_progress(len(self._batches), self.evaluations, self.best_loss)
        if self._budget.target is not None and self.best_loss <= self._budget.target:
            raise BudgetSpent(StopReason.TARGET)
        if allowed < len(population):
            raise BudgetSpent(StopReason.EVALUATIONS)
        return losses

    def result(self, stop_reason: StopReason, message: str = "") -> OptimiserResult:
        """Outcome so far; at least one batch must have been evaluated."""
        evaluated = torch.cat([points for points, _ in self._batches])
        losses = torch.cat([losses for _, losses in self._batches])
        best = int(losses.argmin())
        best_of_batches = torch.stack([losses.min() for _, losses in self._batches])
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


def run_ask_tell(
    optimiser: AskTellOptimiser[State],
    objective: Objective,
    dimension: int,
    budget: Budget,
    seed: int,
    on_progress: Progress | None = None,
    start: Tensor | None = None,
) -> OptimiserResult:
    """Minimise with a population method; arguments, result and errors as of `Minimiser.minimise` and `run_logged`."""

    def search(log: EvaluationLog) -> StopReason:
        state = optimiser.init(dimension, seeded_generator(seed), check_start(start, dimension))
        while (reason := optimiser.stop_reason(state)) is None:
            population, state = optimiser.ask(state)
            state = optimiser.tell(state, population, log.evaluate(population))
        return reason

    return run_logged(search, objective, dimension, budget, on_progress)


@dataclass(frozen=True)
class AskTellMinimiser(Generic[State]):
    """A population method in the coat of a `Minimiser`."""

    optimiser: AskTellOptimiser[State]

    def minimise(
        self,
        objective: Objective,
        dimension: int,
        budget: Budget,
        seed: int,
        on_progress: Progress | None = None,
        start: Tensor | None = None,
    ) -> OptimiserResult:
        """Search the unit cube; see `Minimiser`."""
        return run_ask_tell(self.optimiser, objective, dimension, budget, seed, on_progress, start)


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
