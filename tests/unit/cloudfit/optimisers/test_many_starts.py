"""A local method from the best points of a design."""

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers.base import Budget, StopReason
from cloudfit.optimisers.many_starts import ManyStarts
from cloudfit.optimisers.nlopt_adapter import NloptMinimiser
from cloudfit.optimisers.space_filling import space_filling_points
from render.errors import ParameterError

LOCAL = NloptMinimiser("sbplx", initial_step=0.05)


def egg_box(population: Tensor) -> Tensor:
    """Nine valleys a third apart, of which the one at 5/6, 5/6 is the deepest."""
    waves = 1.0 - (6.0 * torch.pi * (population - 1 / 6)).cos()
    return waves.sum(dim=1) + (5 / 6 - population).clamp(min=0.0).sum(dim=1)


def test_the_design_is_one_batch_and_its_best_point_starts_first() -> None:
    result = ManyStarts(LOCAL, starts=1, design=32).minimise(egg_box, 2, Budget(), 4)
    design = space_filling_points(32, 2, 4).float()
    assert torch.equal(result.evaluated[:32], design)
    assert torch.equal(result.evaluated[32], design[egg_box(design).argmin()])
    assert result.iterations == 1 + result.evaluations - 32


def test_more_starts_find_the_deepest_valley_where_one_does_not() -> None:
    few, many = (
        [
            ManyStarts(LOCAL, starts=starts, design=12).minimise(egg_box, 2, Budget(), seed).best_loss
            for seed in range(8)
        ]
        for starts in (1, 8)
    )
    assert max(many) < 1e-3
    assert max(few) > 0.1


def test_starts_are_apart_from_each_other_and_from_where_others_ended() -> None:
    firsts: list[Tensor] = []

    class Remember:
        def minimise(self, objective, dimension, budget, seed, on_progress=None, start=None):  # type: ignore[no-untyped-def]
            firsts.append(start)
            return LOCAL.minimise(objective, dimension, budget, seed, on_progress, start)

    result = ManyStarts(Remember(), starts=64, design=64, separation=0.2).minimise(egg_box, 2, Budget(), 1)
    apart = (torch.stack(firsts)[:, None] - torch.stack(firsts)[None]).abs().amax(dim=2)
    apart.fill_diagonal_(1.0)
    assert 5 < len(firsts) < 25
    assert float(apart.min()) >= 0.2
    assert result.stop_reason is StopReason.CONVERGED


def test_a_start_joins_the_design_and_the_budget_is_shared() -> None:
    start = torch.tensor([5 / 6, 5 / 6])
    result = ManyStarts(LOCAL).minimise(egg_box, 2, Budget(evaluations=100), 1, start=start)
    assert torch.equal(result.evaluated[0], start)
    assert torch.equal(result.evaluated[64], start)
    assert (result.evaluations, result.stop_reason) == (100, StopReason.EVALUATIONS)


def test_impossible_numbers_are_refused() -> None:
    for keywords in ({"starts": 0}, {"starts": 65}, {"separation": 1.0}):
        with pytest.raises(ParameterError, match="starts <= design"):
            ManyStarts(LOCAL, **keywords)  # type: ignore[arg-type]
