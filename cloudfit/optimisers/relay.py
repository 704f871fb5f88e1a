"""Several runs, one after the other, on one budget and with one result."""

import time
from collections.abc import Callable
from dataclasses import replace

from cloudfit.optimisers.base import Budget, OptimiserResult, Progress, StopReason, pool_results

NOTHING_MORE_TO_DO = (StopReason.TARGET, StopReason.INTERRUPTED, StopReason.FAILED)

Leg = Callable[[Budget, Progress], OptimiserResult]
"""A run with what is left of the budget."""


class Relay:
    """The runs so far and what they leave; as the log of evaluations is for one run, this changes while a relay runs.

    Args:
        budget: of all runs together.
        on_progress: called with the totals of all runs.
    """

    def __init__(self, budget: Budget, on_progress: Progress | None) -> None:
        self._budget = budget
        self._on_progress = on_progress
        self._began = time.perf_counter()
        self.results: list[OptimiserResult] = []
        self._end: StopReason | None = None
        self._message = ""

    def run(self, leg: Leg, share: float = 1.0) -> bool:
        """Run the next leg, unless nothing is left for it.

        Args:
            leg: the run.
            share: part of what is left that it may spend.

        Returns:
            Whether there is a reason to go on.

        Raises:
            Exception: that of the first leg, and KeyboardInterrupt, when nothing had been evaluated yet.
        """
        rest = self._rest()
        if isinstance(rest, StopReason):
            self._end = rest
            return False
        try:
            result = leg(_part_of(rest, share), self._report)
        except (KeyboardInterrupt, Exception) as error:
            if not self.results:
                raise
            self._end = StopReason.INTERRUPTED if isinstance(error, KeyboardInterrupt) else StopReason.FAILED
            self._message = "" if isinstance(error, KeyboardInterrupt) else f"{type(error).__name__}: {error}"
            return False
        self.results.append(result)
        return result.stop_reason not in NOTHING_MORE_TO_DO

    def result(self) -> OptimiserResult:
        """All runs as one; it ended for the reason of the last one, or because the budget left nothing for another."""
        pooled = pool_results(self.results)
        if self._end is None:
            return pooled
        return replace(pooled, stop_reason=self._end, message=self._message or pooled.message)

    def _report(self, iterations: int, evaluations: int, best_loss: float) -> None:
        if self._on_progress is not None:
            before = self.results
            self._on_progress(
                sum(result.iterations for result in before) + iterations,
                sum(result.evaluations for result in before) + evaluations,
                min([best_loss, *(result.best_loss for result in before)]),
            )

    def _rest(self) -> Budget | StopReason:
        """Budget that is left, or the reason why nothing is."""
        spent = sum(result.evaluations for result in self.results)
        evaluations, seconds = self._budget.evaluations, self._budget.seconds
        if evaluations is not None:
            evaluations -= spent
            if evaluations <= 0:
                return StopReason.EVALUATIONS
        if seconds is not None and self.results:
            seconds -= time.perf_counter() - self._began
            if seconds <= 0:
                return StopReason.SECONDS
        return replace(self._budget, evaluations=evaluations, seconds=seconds)


def _part_of(budget: Budget, share: float) -> Budget:
    evaluations, seconds = budget.evaluations, budget.seconds
    return replace(
        budget,
        evaluations=None if evaluations is None else max(1, round(share * evaluations)),
        seconds=None if seconds is None else share * seconds,
    )
