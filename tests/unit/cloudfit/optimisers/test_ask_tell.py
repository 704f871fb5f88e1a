"""The loop around a population method."""

from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers.ask_tell import AskTellMinimiser, run_ask_tell
from cloudfit.optimisers.base import Budget, StopReason
from render.errors import ParameterError


@dataclass(frozen=True)
class Steps:
    position: Tensor
    told: tuple[float, ...] = ()


class Walk:
    """Goes right in steps of a tenth, three points at a time, until it is told a loss above 0.5."""

    def init(self, dimension: int, generator: torch.Generator, start: Tensor | None = None) -> Steps:
        return Steps(0.1 * torch.rand(dimension, generator=generator, dtype=torch.float64) if start is None else start)

    def ask(self, state: Steps) -> tuple[Tensor, Steps]:
        return torch.stack([state.position + 0.1 * step for step in range(3)]), state

    def tell(self, state: Steps, population: Tensor, losses: Tensor) -> Steps:
        return replace(state, position=population[-1] + 0.1, told=(*state.told, *losses.tolist()))

    def stop_reason(self, state: Steps) -> StopReason | None:
        return StopReason.CONVERGED if state.told and state.told[-1] > 0.5 else None


def first_column(population: Tensor) -> Tensor:
    return population[:, 0]


def test_what_is_asked_is_evaluated_and_told() -> None:
    result = run_ask_tell(Walk(), first_column, 1, Budget(), 0, start=torch.tensor([0.05]))
    assert result.evaluated[:, 0].tolist() == pytest.approx([0.05, 0.15, 0.25, 0.35, 0.45, 0.55])
    assert (result.stop_reason, result.iterations) == (StopReason.CONVERGED, 2)


def test_the_seed_is_that_of_the_method() -> None:
    runs = [AskTellMinimiser(Walk()).minimise(first_column, 2, Budget(), seed).evaluated[0] for seed in (1, 1, 2)]
    assert torch.equal(runs[0], runs[1])
    assert not torch.equal(runs[0], runs[2])


def test_no_parameter_is_an_error() -> None:
    with pytest.raises(ParameterError, match="at least one parameter"):
        run_ask_tell(Walk(), first_column, 0, Budget(), 0)
