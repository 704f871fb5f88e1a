"""Operators of the genetic algorithm by statistics, its rules to stop, and a race against random search."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers.ask_tell import run_ask_tell
from cloudfit.optimisers.base import Budget, StopReason
from cloudfit.optimisers.genetic import (
    BITS,
    LARGEST_CODE,
    GeneticAlgorithm,
    cross_over,
    decode,
    encode,
    mutate,
    select_parents,
)
from render.errors import ParameterError


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def worst_z(counts: Tensor, probability: Tensor, draws: int) -> float:
    """Largest deviation of binomial counts from their means in standard deviations."""
    mean = draws * probability
    return float(((counts - mean).abs() / (mean * (1 - probability)).sqrt()).max())


def test_strings_span_the_cube_most_significant_bit_first() -> None:
    bits = torch.zeros(4, 2 * BITS, dtype=torch.bool)
    bits[1] = True
    bits[2, 0] = True
    bits[3, BITS - 1] = True
    expected = torch.tensor([[0, 0], [1, 1], [2**31 / LARGEST_CODE, 0], [1 / LARGEST_CODE, 0]], dtype=torch.float64)
    assert torch.equal(decode(bits), expected)


def test_encoding_is_the_inverse_to_half_a_step() -> None:
    population = torch.rand(500, 5, generator=generator(1), dtype=torch.float64)
    assert float((decode(encode(population)) - population).abs().max()) <= 0.5 / LARGEST_CODE * (1 + 1e-6)
    bits = torch.rand(500, 3 * BITS, generator=generator(2)) < 0.5
    assert torch.equal(encode(decode(bits)), bits)


def test_roulette_draws_in_proportion_to_the_papers_fitness() -> None:
    losses = torch.tensor([0.0, 0.25, 1.0, 3.0], dtype=torch.float64)
    fitness = 1 / (losses + 1)
    draws = 40_000
    counts = torch.bincount(select_parents(losses, draws, generator(3)), minlength=4)
    # Four bins at 4 standard deviations: less than one false alarm in 3000 seeds.
    assert worst_z(counts, fitness / fitness.sum(), draws) < 4
    other = 1 / (losses + 0.5)
    assert worst_z(counts, other / other.sum(), draws) > 4


def test_roulette_allows_negative_losses() -> None:
    losses = torch.tensor([-3.0, -2.0], dtype=torch.float64)
    counts = torch.bincount(select_parents(losses, 30_000, generator(4)), minlength=2)
    assert worst_z(counts, torch.tensor([2 / 3, 1 / 3], dtype=torch.float64), 30_000) < 4


def test_a_crossed_child_has_one_segment_of_its_second_parent() -> None:
    count, length = 3000, 40
    first, second = torch.zeros(count, length, dtype=torch.bool), torch.ones(count, length, dtype=torch.bool)
    children = cross_over(first, second, 1.0, generator(6))
    borders = (children[:, 1:] != children[:, :-1]).sum(dim=1)
    assert int(borders.max()) == 2
    # Two uniform cuts of 0..length: the mean length of the segment is length (length + 2) / (3 (length + 1)).
    lengths = children.double().sum(dim=1)
    expected = length * (length + 2) / (3 * (length + 1))
    error = float(lengths.std()) / math.sqrt(count)
    assert abs(float(lengths.mean()) - expected) < 4 * error
    assert abs(float(lengths.mean()) - length / 2) > 4 * error
    # Either end of the string can be cut off.
    assert bool(children[:, 0].any())
    assert bool(children[:, -1].any())


def test_crossover_probability() -> None:
    count, length = 20_000, 64
    first, second = torch.zeros(count, length, dtype=torch.bool), torch.ones(count, length, dtype=torch.bool)
    assert torch.equal(cross_over(first, second, 0.0, generator(7)), first)
    crossed = cross_over(first, second, 0.6, generator(7)).any(dim=1).sum()
    # A pair with equal cuts, one in length + 1, looks as if not crossed.
    assert worst_z(crossed, torch.tensor(0.6 * (1 - 1 / (length + 1))), count) < 4


def test_mutation_flips_each_bit_with_its_probability() -> None:
    bits = torch.rand(4000, 32, generator=generator(8)) < 0.5
    flipped = (mutate(bits, 0.1, generator(9)) ^ bits).sum(dim=0)
    # 32 positions at 4.5 standard deviations.
    assert worst_z(flipped, torch.tensor(0.1), 4000) < 4.5
    assert torch.equal(mutate(bits, 0.0, generator(9)), bits)
    assert torch.equal(mutate(bits, 1.0, generator(9)), ~bits)


def bowl(population: Tensor) -> Tensor:
    return ((population - 0.3) ** 2).sum(dim=1)


def test_state_is_frozen_and_a_step_is_a_function_of_it() -> None:
    algorithm = GeneticAlgorithm()
    state = algorithm.init(3, generator(10))
    population, state = algorithm.ask(state)
    losses = bowl(population)
    before = (state.candidates.clone(), state.elite.clone())
    steps = [algorithm.tell(state, population, losses) for _ in range(2)]
    assert torch.equal(steps[0].candidates, steps[1].candidates)
    assert torch.equal(state.candidates, before[0])
    assert torch.equal(state.elite, before[1])
    other = algorithm.tell(replace(state, seed=state.seed + 1), population, losses)
    assert not torch.equal(other.candidates, steps[0].candidates)


@pytest.mark.parametrize("elite_size", [1, 4])
def test_the_elite_lives_on_and_is_not_evaluated_again(elite_size: int) -> None:
    algorithm = GeneticAlgorithm(elite_size=elite_size)
    state = algorithm.init(2, generator(11))
    seen: list[Tensor] = []
    for iteration in range(6):
        population, state = algorithm.ask(state)
        assert len(population) == (20 if iteration == 0 else 20 - elite_size)
        seen.append(bowl(population))
        state = algorithm.tell(state, population, seen[-1])
        best = torch.cat(seen).sort().values[:elite_size]
        torch.testing.assert_close(state.elite_losses, best)
        torch.testing.assert_close(bowl(decode(state.elite)), best)


def test_it_ends_at_the_target() -> None:
    result = run_ask_tell(GeneticAlgorithm(target=0.05), bowl, 4, Budget(), 1)
    assert result.stop_reason is StopReason.TARGET
    assert result.best_loss < 0.05 <= float(result.history[-2])
    assert GeneticAlgorithm.paper().target == 0.5
    assert GeneticAlgorithm().target is None


def test_it_ends_when_nothing_improves() -> None:
    flat = run_ask_tell(GeneticAlgorithm(), lambda population: torch.ones(len(population)), 4, Budget(), 1)
    assert flat.stop_reason is StopReason.STAGNATION
    # The first generation, and those that did not improve on it.
    assert flat.iterations == 1 + GeneticAlgorithm().stagnation_iterations


def test_it_ends_after_the_largest_number_of_iterations() -> None:
    calls = iter(range(10_000, 0, -1))
    result = run_ask_tell(
        GeneticAlgorithm(), lambda population: torch.full((len(population),), float(next(calls))), 4, Budget(), 1
    )
    assert result.stop_reason is StopReason.ITERATIONS
    assert result.iterations == GeneticAlgorithm().largest_iterations


def test_the_papers_rules() -> None:
    paper = GeneticAlgorithm.paper()
    assert (paper.population_size, paper.stagnation_iterations, paper.largest_iterations) == (20, 20, 100)
    assert (paper.target, BITS) == (0.5, 32)


def hills(population: Tensor) -> Tensor:
    """Rastrigin's function, 5^dimension local minima or more, with the lowest off the centre at 0.37."""
    x = 6 * (population.double() - 0.37)
    return (x**2 + 3 * (1 - torch.cos(2 * math.pi * x))).sum(dim=1)


def test_it_beats_random_search_at_equal_evaluations() -> None:
    evaluations, seeds = 1000, range(12)
    algorithm = GeneticAlgorithm(stagnation_iterations=1000)
    bred = [run_ask_tell(algorithm, hills, 5, Budget(evaluations=evaluations), seed) for seed in seeds]
    assert all(result.evaluations == evaluations for result in bred)
    random = [float(hills(torch.rand(evaluations, 5, generator=generator(1000 + seed))).min()) for seed in seeds]
    wins = sum(result.best_loss < other for result, other in zip(bred, random, strict=True))
    # Sign test: 11 or more wins of 12 have a probability of 0.3 % between equals.
    assert wins >= 11


@pytest.mark.parametrize(
    "keywords",
    [
        {"population_size": 1},
        {"elite_size": 20},
        {"elite_size": 0},
        {"crossover_probability": 1.5},
        {"mutations": -1.0},
        {"stagnation_iterations": 0},
        {"largest_iterations": 0},
    ],
)
def test_impossible_hyper_parameters_are_refused(keywords: dict[str, float]) -> None:
    with pytest.raises(ParameterError, match="expected"):
        GeneticAlgorithm(**keywords)  # type: ignore[arg-type]
