"""The parts of the method, and what the screening is worth."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers.ask_tell import AskTellMinimiser
from cloudfit.optimisers.base import Budget, Minimiser, StopReason
from cloudfit.optimisers.genetic import GeneticAlgorithm
from cloudfit.optimisers.nlopt_adapter import NloptMinimiser
from cloudfit.optimisers.screened_evolution import (
    EvolutionState,
    ScreenedEvolution,
    best_first,
    breed,
    choose,
    model_data,
)
from render.errors import ParameterError


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def rough(population: Tensor) -> Tensor:
    """A rotated canyon with waves and small steps, whose minimum of about 0.1 is at 0.37."""
    offset = population.double() - 0.37
    turned = torch.stack(
        [offset.sum(dim=1), *(offset[:, k] - offset[:, k + 1] for k in range(offset.shape[1] - 1))], dim=1
    )
    waves = 0.02 * (1.0 - (40.0 * turned).cos()).sum(dim=1)
    return ((0.1 + turned.norm(dim=1) + waves) * 500).round() / 500


def test_children_come_from_the_elite() -> None:
    elite = torch.rand(20, 4, generator=seeded(), dtype=torch.float64) * 0.1 + 0.6
    children = breed(elite, 3000, seeded(1))
    assert children.shape == (3000, 4)
    # parent + F (better - parent) + F (one - other), all within a box of side 0.1, F up to 0.9
    assert float(children.min()) >= 0.6 - 0.09
    assert float(children.max()) <= 0.7 + 0.09 + 1e-12
    # With 0.3, 0.9 and 1 of the parameters mutated, about 0.27 are those of one of the best four.
    inherited = torch.isin(children, elite[:4]).double().mean()
    assert 0.23 < float(inherited) < 0.31
    # What lies outside is moved onto the bound.
    low = breed(elite - 0.62, 3000, seeded(1))
    assert float(low.min()) == 0.0
    assert float((low == 0.0).double().mean()) > 0.1
    # Of an elite that has collapsed all children are the same.
    assert len(breed(elite[:1].expand(20, 4), 50, seeded()).unique(dim=0)) == 1


def test_choice_weighs_promise_and_distance() -> None:
    children = torch.tensor([[0.0], [0.1], [0.5], [1.0]], dtype=torch.float64)
    predicted = torch.tensor([0.0, 0.1, 1.0, 0.9], dtype=torch.float64)
    evaluated = torch.tensor([[0.05]], dtype=torch.float64)
    assert choose(predicted, children, evaluated, 2, (1.0,)).tolist() == [0, 1]
    assert choose(predicted, children, evaluated, 2, (0.0,)).tolist() == [3, 2]
    assert choose(predicted, children, evaluated, 2, (1.0, 0.0)).tolist() == [0, 3]
    # A child that has been evaluated already comes last however promising.
    assert choose(predicted, children, children[:1], 1, (1.0,)).tolist() == [1]
    assert choose(predicted, children, children, 2, (1.0,)).tolist() == [0, 0]


def test_the_model_sees_the_best_points_and_the_nearest() -> None:
    points = torch.rand(1000, 2, generator=seeded(), dtype=torch.float64)
    losses = torch.rand(1000, generator=seeded(1), dtype=torch.float64)
    chosen, theirs = model_data(points, losses, points[losses.argmin()])
    assert chosen.shape == (240, 2)
    assert len(chosen.unique(dim=0)) == 240
    assert torch.equal(theirs[:120], losses.sort().values[:120])
    assert float((chosen[120:] - points[losses.argmin()]).norm(dim=1).max()) < 0.35
    few, _ = model_data(points[:50], losses[:50], points[0])
    assert len(few) == 50


def test_runs_end_without_improvement_and_every_other_unites() -> None:
    method = ScreenedEvolution(population_size=4, first_design=8, later_design=6, patience=2)
    state = method.init(2, seeded())
    sizes, runs, begins = [], [], []
    for _ in range(13):
        population, state = method.ask(state)
        state = method.tell(state, population, torch.ones(len(population), dtype=torch.float64))
        sizes.append(len(population))
        runs.append(state.runs)
        begins.append(state.begins)
    #       a first look, design and 2 gens; design and 2; united: 2; design and 2; united
    assert sizes == [1, 7, 4, 4, 6, 4, 4, 4, 4, 6, 4, 4, 4]
    assert runs == [0, 0, 0, 1, 1, 1, 2, 2, 3, 3, 3, 4, 4]
    assert begins == [0, 0, 0, 16, 16, 16, 0, 0, 38, 38, 38, 0, 0]


def test_improvement_is_relative_and_that_of_the_run() -> None:
    method = ScreenedEvolution(least_improvement=0.01)
    points = torch.rand(30, 2, generator=seeded(), dtype=torch.float64)
    losses = torch.cat([torch.full((10,), 0.1), torch.full((20,), 2.0)]).double()
    state = EvolutionState(1, points, losses, None, begins=10, unchanged=3, runs=1, iterations=5)
    population, _ = method.ask(state)
    better, slightly = (torch.full((20,), loss, dtype=torch.float64) for loss in (1.97, 1.99))
    assert method.tell(state, population, better).unchanged == 0
    assert method.tell(state, population, slightly).unchanged == 4
    assert method.tell(replace(state, begins=0, runs=2), population, better).unchanged == 4


def test_only_the_run_s_own_points_breed_unless_it_unites() -> None:
    method = ScreenedEvolution(elite_size=5, united_elite_size=8)
    points = torch.rand(30, 2, generator=seeded(), dtype=torch.float64)
    losses = torch.linspace(0.0, 1.0, 30, dtype=torch.float64)
    state = EvolutionState(1, points, losses, None, begins=10, runs=1)
    assert torch.equal(method._elite(state), points[10:15])
    assert torch.equal(method._elite(replace(state, begins=0, runs=2)), points[:8])
    assert torch.equal(method._elite(replace(state, begins=0, runs=0)), points[:5])
    assert best_first(torch.tensor([3.0, 1.0, 2.0]), 2).tolist() == [1, 2]


def median_loss(method: Minimiser, evaluations: int) -> float:
    runs = [method.minimise(rough, 5, Budget(evaluations=evaluations), seed) for seed in range(7)]
    return sorted(run.best_loss for run in runs)[3]


def test_screening_is_worth_more_than_evaluating_every_child() -> None:
    screened, all_children = (AskTellMinimiser(ScreenedEvolution(children=children)) for children in (15, 1))
    assert median_loss(screened, 300) + 0.03 < median_loss(all_children, 300)


@pytest.mark.parametrize("evaluations", [100, 300, 900])
def test_it_is_ahead_of_controlled_random_search_and_the_genetic_algorithm_at_any_time(evaluations: int) -> None:
    ours = median_loss(AskTellMinimiser(ScreenedEvolution()), evaluations)
    for other in (NloptMinimiser("crs2_lm"), AskTellMinimiser(GeneticAlgorithm())):
        assert ours < median_loss(other, evaluations)


def test_iterations_are_limited_and_numbers_checked() -> None:
    method = AskTellMinimiser(ScreenedEvolution(largest_iterations=3))
    result = method.minimise(rough, 3, Budget(), 1)
    assert (result.stop_reason, result.evaluations) == (StopReason.ITERATIONS, 1 + 31 + 20)
    assert torch.equal(result.evaluated[0], torch.full((3,), 0.5))
    for look in (0, 32):
        with pytest.raises(ParameterError, match="first_look"):
            ScreenedEvolution(first_look=look)
    for keywords in (
        {"population_size": 0},
        {"children": 0},
        {"first_design": 2, "later_design": 1},
        {"elite_size": 1},
        {"patience": 0},
    ):
        with pytest.raises(ParameterError, match="expected at least one child"):
            ScreenedEvolution(**keywords)  # type: ignore[arg-type]
    for keywords in ({"weights": ()}, {"weights": (1.5,)}, {"least_improvement": -1.0}):
        with pytest.raises(ParameterError, match="expected weights"):
            ScreenedEvolution(**keywords)  # type: ignore[arg-type]
