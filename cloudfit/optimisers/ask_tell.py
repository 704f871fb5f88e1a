"""Population methods as `init / ask / tell` over a frozen state, and the loop around them."""

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import torch
from torch import Tensor

from cloudfit.optimisers.base import (
    Budget,
    EvaluationLog,
    Objective,
    OptimiserResult,
    Progress,
    StopReason,
    check_start,
    run_logged,
    seeded_generator,
)

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
