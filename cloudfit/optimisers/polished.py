"""A global search followed by a local one from its best point."""

from dataclasses import dataclass

from torch import Tensor

from cloudfit.optimisers.base import Budget, Minimiser, Objective, OptimiserResult, Progress
from cloudfit.optimisers.relay import Relay
from render.errors import ParameterError


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
        relay = Relay(budget, on_progress)
        if relay.run(
            lambda rest, report: self.first.minimise(objective, dimension, rest, seed, report, start), self.first_share
        ):
            best = relay.results[0].best
            relay.run(lambda rest, report: self.second.minimise(objective, dimension, rest, seed, report, best))
        return relay.result()
