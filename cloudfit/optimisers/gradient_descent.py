"""Methods that follow the objective's own gradient from many starts at once: what they share."""

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from torch import Tensor

from cloudfit.optimisers.base import (
    Budget,
    EvaluationLog,
    Objective,
    OptimiserResult,
    Progress,
    StopReason,
    check_start,
    require_gradient,
    run_logged,
    seeded_generator,
)
from cloudfit.optimisers.space_filling import space_filling_points
from render.errors import ParameterError

State = TypeVar("State")


class GradientMethod(Protocol[State]):
    """Many descents side by side over one frozen state; every step is a pure function of it."""

    def init(self, starts: Tensor) -> State:
        """The state before the first evaluation, from the starts (start, parameter), float64."""
        ...

    def ask(self, state: State) -> Tensor:
        """Points to evaluate, (population, parameter) float64 in the unit cube."""
        ...

    def tell(self, state: State, losses: Tensor, gradient: Tensor) -> State:
        """Take the losses (population,) and gradients (population, parameter) of the points of `ask`, finite, float64."""
        ...

    def stop_reason(self, state: State) -> StopReason | None:
        """Return why the method itself would end now, or None."""
        ...


@dataclass(frozen=True)
class GradientMinimiser(Generic[State]):
    """A gradient method in the coat of a `Minimiser`; its objective must be a `DifferentiableObjective`.

    Args:
        method: what to do with the gradients.
        starts: descents side by side, from a space-filling design; as many as one batch takes almost for the price of one.

    Raises:
        ParameterError: when there is no start.
    """

    method: GradientMethod[State]
    starts: int = 16

    def __post_init__(self) -> None:
        if self.starts < 1:
            raise ParameterError(f"expected at least one start, got {self.starts}")

    def minimise(
        self,
        objective: Objective,
        dimension: int,
        budget: Budget,
        seed: int,
        on_progress: Progress | None = None,
        start: Tensor | None = None,
    ) -> OptimiserResult:
        """Search the unit cube; see `Minimiser`. A point counts as one evaluation, its gradient included.

        Raises:
            ParameterError: when the objective has no gradient.
        """
        require_gradient(objective)
        seeded_generator(seed)

        def search(log: EvaluationLog) -> StopReason:
            state = self.method.init(space_filling_points(self.starts, dimension, seed, check_start(start, dimension)))
            while (reason := self.method.stop_reason(state)) is None:
                state = self.method.tell(state, *log.evaluate_with_gradient(self.method.ask(state)))
            return reason

        return run_logged(search, objective, dimension, budget, on_progress)
