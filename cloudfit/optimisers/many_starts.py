"""A local method from many starting points: the best of a space-filling design first."""

from dataclasses import dataclass

from torch import Tensor

from cloudfit.optimisers.base import (
    Budget,
    EvaluationLog,
    Minimiser,
    Objective,
    OptimiserResult,
    Progress,
    StopReason,
    check_start,
    run_logged,
    seeded_generator,
)
from cloudfit.optimisers.relay import Relay
from cloudfit.optimisers.space_filling import space_filling_points
from render.errors import ParameterError


@dataclass(frozen=True)
class ManyStarts:
    """Evaluates a design in one batch, then runs `local` from its points in the order of their losses, apart from each other.

    A point nearer than `separation` to a start or an end of an earlier run is left out: it would find the same again.

    Args:
        local: method that uses a start.
        starts: largest number of local runs.
        design: points of the design, among which the starts are chosen.
        separation: largest difference of any parameter at which two points count as one start.

    Raises:
        ParameterError: when a number is outside its domain.
    """

    local: Minimiser
    starts: int = 16
    design: int = 64
    separation: float = 0.1

    def __post_init__(self) -> None:
        if not (1 <= self.starts <= self.design and 0.0 <= self.separation < 1.0):
            raise ParameterError(
                f"expected 1 <= starts <= design and a separation in 0..1, got {self.starts}, {self.design} and {self.separation}"
            )

    def minimise(
        self,
        objective: Objective,
        dimension: int,
        budget: Budget,
        seed: int,
        on_progress: Progress | None = None,
        start: Tensor | None = None,
    ) -> OptimiserResult:
        """Search the unit cube; see `Minimiser`. A start joins the design."""
        seeded_generator(seed)
        relay = Relay(budget, on_progress)

        def look_around(rest: Budget, report: Progress) -> OptimiserResult:
            def evaluate(log: EvaluationLog) -> StopReason:
                log.evaluate(space_filling_points(self.design, dimension, seed, check_start(start, dimension)))
                return StopReason.CONVERGED

            return run_logged(evaluate, objective, dimension, rest, report)

        goes_on = relay.run(look_around)
        points = relay.results[0].evaluated[relay.results[0].losses.argsort(stable=True)]
        visited: list[Tensor] = []
        for point in points:
            if not goes_on or len(relay.results) > self.starts:
                break
            if any(float((point - other).abs().max()) < self.separation for other in visited):
                continue
            number = len(relay.results)
            goes_on = relay.run(
                # The loop variables are bound at once: the leg runs before they change.
                lambda rest, report, at=point, number=number: self.local.minimise(  # type: ignore[misc]
                    objective, dimension, rest, seed + number, report, at
                )
            )
            visited += [point, *(result.best for result in relay.results[number:])]
        return relay.result()
