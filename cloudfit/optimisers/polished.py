"""A global search followed by a local one from its best point."""

import time
from dataclasses import dataclass, replace

from torch import Tensor

from cloudfit.optimisers.base import Budget, Minimiser, Objective, OptimiserResult, Progress, StopReason, pool_results
from render.errors import ParameterError

NOTHING_TO_POLISH = (StopReason.TARGET, StopReason.INTERRUPTED, StopReason.FAILED)


@dataclass(frozen=True)
class Polished:
    """Runs `first`, then `second` from the best point found.

    Args:
        first: global method.
        second: local method, one that uses a start.
        first_share: part of the evaluations and of the time that the first may spend; the second has what is left.

    Raises:
        ParameterError: when the share is not inside 0..1.
    """

    first: Minimiser
    second: Minimiser
    first_share: float = 0.75

    def __post_init__(self) -> None:
        if not 0.0 < self.first_share < 1.0:
            raise ParameterError(f"expected a first_share between 0 and 1, got {self.first_share}")

    def minimise(
        self,
        objective: Objective,
        dimension: int,
        budget: Budget,
        seed: int,
        on_progress: Progress | None = None,
        start: Tensor | None = None,
    ) -> OptimiserResult:
        """Search the unit cube; see `Minimiser`. The reason to stop is that of the last method that ran."""
        began = time.perf_counter()
        first = self.first.minimise(objective, dimension, self._first_budget(budget), seed, on_progress, start)
        rest = _rest_of(budget, first.evaluations, time.perf_counter() - began)
        if first.stop_reason in NOTHING_TO_POLISH or isinstance(rest, StopReason):
            return first if isinstance(rest, Budget) else replace(first, stop_reason=rest)

        def report(iterations: int, evaluations: int, best_loss: float) -> None:
            if on_progress is not None:
                on_progress(
                    first.iterations + iterations, first.evaluations + evaluations, min(first.best_loss, best_loss)
                )

        try:
            second = self.second.minimise(objective, dimension, rest, seed, report, first.best)
        except KeyboardInterrupt:
            return replace(first, stop_reason=StopReason.INTERRUPTED)
        except Exception as error:
            return replace(first, stop_reason=StopReason.FAILED, message=f"{type(error).__name__}: {error}")
        return pool_results([first, second])

    def _first_budget(self, budget: Budget) -> Budget:
        evaluations, seconds = budget.evaluations, budget.seconds
        return replace(
            budget,
            evaluations=None if evaluations is None else max(1, round(self.first_share * evaluations)),
            seconds=None if seconds is None else self.first_share * seconds,
        )


def _rest_of(budget: Budget, evaluations: int, seconds: float) -> Budget | StopReason:
    """Budget that is left, or the reason why nothing is."""
    if budget.evaluations is not None and evaluations >= budget.evaluations:
        return StopReason.EVALUATIONS
    if budget.seconds is not None and seconds >= budget.seconds:
        return StopReason.SECONDS
    return replace(
        budget,
        evaluations=None if budget.evaluations is None else budget.evaluations - evaluations,
        seconds=None if budget.seconds is None else budget.seconds - seconds,
    )
