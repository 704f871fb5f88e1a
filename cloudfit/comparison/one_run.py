"""One run: a method on a problem from a seed, timed, started again while budget is left, and scored once more at its end."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from cloudfit.comparison.problems import Problem
from cloudfit.comparison.run_record import Floats, RunRecord, Trace
from cloudfit.optimisers.base import PENALTY, Budget, Minimiser, Objective, OptimiserResult, Progress, StopReason
from render.errors import ParameterError

RESTARTING = (StopReason.CONVERGED, StopReason.STAGNATION, StopReason.ITERATIONS, StopReason.TARGET)
"""Reasons of a method's own to stop, after which it is started again from another seed; a target of the budget's is none."""

SEED_STRIDE = 100_003
"""Between the seeds of the starts of a run: larger than any number of runs."""


Answer = TypeVar("Answer")


def run_clock() -> Callable[[], float]:
    """Seconds of the processor where a run has one thread, since other work on the machine does not lengthen them; else wall time."""
    return time.process_time if torch.get_num_threads() == 1 else time.perf_counter


class TimedObjective:
    """Counts and times what a method asks for, from outside: all methods are measured by the same clock.

    Args:
        objective: (population, parameter) -> (population,); where it has a `with_gradient`, so has this.
    """

    def __init__(self, objective: Objective) -> None:
        self._objective = objective
        self.clock = run_clock()
        self.began = self.clock()
        self.seconds = 0.0
        self._known: list[tuple[int, float]] = []
        gradient = getattr(objective, "with_gradient", None)
        if gradient is not None:
            self.with_gradient = lambda population: self._timed(gradient, population)

    def __call__(self, population: Tensor) -> Tensor:
        """The losses of the objective."""
        return self._timed(self._objective, population)

    def _timed(self, compute: Callable[[Tensor], Answer], population: Tensor) -> Answer:
        started = self.clock()
        answer = compute(population)
        ended = self.clock()
        self.seconds += ended - started
        self._known.append((len(population), ended - self.began))
        return answer

    def times(self) -> Floats:
        """Seconds since the beginning at which each loss was known `(evaluation,)`."""
        return np.repeat([seconds for _, seconds in self._known], [count for count, _ in self._known]).astype(float)


@dataclass(frozen=True)
class Task:
    """One run to be done.

    Args:
        method: name and settings.
        seed: 0 or more.
        budget: of the whole run.
        restarts: whether a method that ends of itself is started again while budget is left.
        fingerprint: of everything that the run depends on.
    """

    method: str
    minimiser: Minimiser
    seed: int
    budget: Budget
    restarts: bool
    fingerprint: str


def perform(problem: Problem, task: Task, on_progress: Progress | None = None) -> RunRecord:
    """Do a run.

    Whatever the method raises makes the run a failed one with a message; what was found before is kept. A method that raises
    ParameterError before it has evaluated anything does not take the problem.

    Raises:
        KeyboardInterrupt: the user asked to stop; the run does not count.
    """
    timed = TimedObjective(problem.objective)
    results: list[OptimiserResult] = []
    message, refused = "", False
    try:
        _search(timed, problem.dimension, task, on_progress, results)
    except ParameterError as error:
        message, refused = str(error), not results
    except Exception as error:  # a method that fails must not end the others
        message = f"{type(error).__name__}: {error}"
    seconds = timed.clock() - timed.began
    if any(result.stop_reason is StopReason.INTERRUPTED for result in results):
        raise KeyboardInterrupt
    failed = bool(message) or not results or results[-1].stop_reason is StopReason.FAILED
    if not message and results:
        message = results[-1].message or results[-1].stop_reason.value
    record = _record(problem, task, timed, results, seconds, failed, message)
    return replace(record, refused=refused)


def _search(
    timed: TimedObjective, dimension: int, task: Task, on_progress: Progress | None, results: list[OptimiserResult]
) -> None:
    """Start the method until the budget is spent, or once; results are appended as they come."""
    while True:
        spent = sum(result.evaluations for result in results)
        best = min((result.best_loss for result in results), default=PENALTY)
        rest = _rest(task.budget, spent, timed.clock() - timed.began)
        if rest is None:
            return

        def report(iterations: int, evaluations: int, loss: float, spent: int = spent, best: float = best) -> None:
            if on_progress is not None:
                on_progress(iterations, spent + evaluations, min(best, loss))

        seed = task.seed + len(results) * SEED_STRIDE
        results.append(task.minimiser.minimise(timed, dimension, rest, seed, report))
        reason, target = results[-1].stop_reason, task.budget.target
        if not task.restarts or reason not in RESTARTING or (reason is StopReason.TARGET and target is not None):
            return


def _rest(budget: Budget, evaluations: int, seconds: float) -> Budget | None:
    """What is left of a budget, or None; the first start gets the budget as it is."""
    if evaluations == 0:
        return budget
    left_evaluations = None if budget.evaluations is None else budget.evaluations - evaluations
    left_seconds = None if budget.seconds is None else budget.seconds - seconds
    if (left_evaluations is not None and left_evaluations < 1) or (left_seconds is not None and left_seconds <= 0):
        return None
    return replace(budget, evaluations=left_evaluations, seconds=left_seconds)


def _record(
    problem: Problem,
    task: Task,
    timed: TimedObjective,
    results: Sequence[OptimiserResult],
    seconds: float,
    failed: bool,
    message: str,
) -> RunRecord:
    losses = np.concatenate([result.losses.numpy() for result in results]) if results else np.empty(0)
    times, objective_seconds = _clock(timed, results, len(losses))
    best = min(results, key=lambda result: result.best_loss).best if results else None
    physical = None if best is None else problem.fit.space.to_physical(best[None].to(torch.float32))[0]
    return RunRecord(
        fingerprint=task.fingerprint,
        problem=problem.name,
        method=task.method,
        seed=task.seed,
        failed=failed,
        message=message,
        starts=len(results),
        evaluations=len(losses),
        seconds=seconds,
        objective_seconds=objective_seconds,
        best=() if best is None else tuple(best.tolist()),
        parameters={} if physical is None else problem.fit.space.as_dict(physical),
        loss=float("inf") if best is None else problem.loss(best),
        threads=torch.get_num_threads(),
        trace=Trace.of_losses(losses, times),
    )


def _clock(timed: TimedObjective, results: Sequence[OptimiserResult], count: int) -> tuple[Floats, float]:
    """When each loss was known, and the time inside the objective.

    A method that evaluates in a process of its own does so out of sight; then its own record counts, where it keeps one.
    """
    times = timed.times()
    if len(times) == count:
        return times, timed.seconds
    if len(times) > count:  # a batch of which a failing method took no notice
        return times[:count], timed.seconds
    offset, own = 0.0, []
    for result in results:
        own.append(np.asarray(getattr(result, "times", np.linspace(0.0, result.seconds, result.evaluations))) + offset)
        offset += result.seconds
    inside = sum(float(getattr(result, "objective_seconds", 0.0)) for result in results)
    return np.concatenate(own), inside
