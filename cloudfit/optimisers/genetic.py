"""The genetic algorithm of Dobashi et al. 2012 (section 4.2): quantised binary strings, two-point crossover, mutation."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cloudfit.optimisers.base import StopReason
from render.errors import ParameterError
from render.random_streams import child_generator

BITS = 32
LARGEST_CODE = 2**BITS - 1


def decode(bits: Tensor) -> Tensor:
    """Points of the unit cube from binary strings: u = code / (2^32 - 1), most significant bit first.

    Args:
        bits: (population, parameter * 32) bool.

    Returns:
        (population, parameter) float64.
    """
    weights = 2 ** torch.arange(BITS - 1, -1, -1, dtype=torch.int64, device=bits.device)
    codes = (bits.unflatten(1, (-1, BITS)) * weights).sum(dim=-1)
    return codes.double() / LARGEST_CODE


def encode(population: Tensor) -> Tensor:
    """Binary strings of the points of the unit cube: the inverse of `decode`, to 1 part in 2^32.

    Args:
        population: (population, parameter).

    Returns:
        (population, parameter * 32) bool.
    """
    codes = (population.double().clamp(0.0, 1.0) * LARGEST_CODE).round().to(torch.int64)
    shifts = torch.arange(BITS - 1, -1, -1, dtype=torch.int64, device=population.device)
    return ((codes[..., None] >> shifts) & 1).bool().flatten(start_dim=1)


def select_parents(losses: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Draw parents with probability proportional to the fitness 1 / (O + 1) of the paper.

    Args:
        losses: (population,) O; where one is negative, all are shifted so that the best is 0.
        count: number of draws.
        generator: source of randomness.

    Returns:
        (count,) indices, with replacement.
    """
    fitness = 1.0 / (losses - losses.min().clamp(max=0.0) + 1.0)
    return torch.multinomial(fitness, count, replacement=True, generator=generator)


def cross_over(first: Tensor, second: Tensor, probability: float, generator: torch.Generator) -> Tensor:
    """Two-point crossover: the bits between two random cuts come from the second parent, the others from the first.

    Args:
        first: (population, bit) bool.
        second: (population, bit) bool.
        probability: that a pair is crossed at all; otherwise the child is the first parent.
        generator: source of randomness.

    Returns:
        (population, bit) bool, one child per pair.
    """
    count, length = first.shape
    cuts = torch.randint(length + 1, (count, 2), generator=generator).sort(dim=1).values
    crossed = torch.rand(count, 1, generator=generator) < probability
    position = torch.arange(length)
    return torch.where(crossed & (position >= cuts[:, :1]) & (position < cuts[:, 1:]), second, first)


def mutate(bits: Tensor, probability: float, generator: torch.Generator) -> Tensor:
    """Flip each bit with the given probability.

    Args:
        bits: (population, bit) bool.
        probability: per bit.
        generator: source of randomness.

    Returns:
        (population, bit) bool.
    """
    return bits ^ (torch.rand(bits.shape, generator=generator) < probability)


@dataclass(frozen=True)
class GeneticState:
    """A generation.

    Args:
        seed: of the run; the random numbers of a generation are a function of it and `iterations`.
        iterations: number of generations evaluated.
        unchanged_iterations: number of generations since the best loss improved.
        candidates: (population, bit) strings to be evaluated next.
        elite: (elite, bit) best strings so far, best first; they need no second evaluation.
        elite_losses: (elite,).
    """

    seed: int
    iterations: int
    unchanged_iterations: int
    candidates: Tensor
    elite: Tensor
    elite_losses: Tensor


@dataclass(frozen=True)
class GeneticAlgorithm:
    """Hyper-parameters of the genetic algorithm; the defaults are the paper's but for `target`, see `paper`.

    The rates of crossover and mutation are ours. On histogram losses of synthetic clouds neither other rates, a larger
    population, a tournament for the roulette nor Gray codes for binary ones made a difference beyond noise.

    Args:
        population_size: individuals per generation, the elite included.
        elite_size: best individuals that live on unchanged.
        crossover_probability: that a child has two parents.
        mutations: expected number of flipped bits per parameter and child.
        target: loss below which the search ends, if any.
        stagnation_iterations: generations without improvement after which it ends.
        largest_iterations: generations after which it ends.

    Raises:
        ParameterError: when a number is outside its domain.
    """

    population_size: int = 20
    elite_size: int = 1
    crossover_probability: float = 0.9
    mutations: float = 0.5
    target: float | None = None
    stagnation_iterations: int = 20
    largest_iterations: int = 100

    def __post_init__(self) -> None:
        if not 1 <= self.elite_size < self.population_size:
            raise ParameterError(
                f"expected 1 <= elite_size < population_size, got {self.elite_size} and {self.population_size}"
            )
        if not (0.0 <= self.crossover_probability <= 1.0 and 0.0 <= self.mutations <= BITS):
            raise ParameterError(
                f"expected a crossover_probability in 0..1 and mutations in 0..{BITS}, got "
                f"{self.crossover_probability} and {self.mutations}"
            )
        if self.stagnation_iterations < 1 or self.largest_iterations < 1:
            raise ParameterError(
                "expected at least one iteration, got stagnation_iterations "
                f"{self.stagnation_iterations} and largest_iterations {self.largest_iterations}"
            )

    @classmethod
    def paper(cls) -> "GeneticAlgorithm":
        """The rules of the paper with its end at O < 0.5, which a photograph may pass long before its best fit."""
        return cls(target=0.5)

    def init(self, dimension: int, generator: torch.Generator, start: Tensor | None = None) -> GeneticState:
        """First generation: random strings, and `start` if there is one."""
        bits = torch.randint(2, (self.population_size, dimension * BITS), generator=generator).bool()
        if start is not None:
            bits[0] = encode(start[None])[0]
        return GeneticState(
            seed=int(torch.randint(2**62, (), generator=generator)),
            iterations=0,
            unchanged_iterations=0,
            candidates=bits,
            elite=bits[:0],
            elite_losses=torch.empty(0, dtype=torch.float64),
        )

    def ask(self, state: GeneticState) -> tuple[Tensor, GeneticState]:
        """Points of the generation to evaluate, (population, parameter) in the unit cube."""
        return decode(state.candidates), state

    def tell(self, state: GeneticState, population: Tensor, losses: Tensor) -> GeneticState:
        """Breed the next generation from the elite and the evaluated one; losses (population,) finite."""
        bits = torch.cat([state.elite, state.candidates])
        losses = torch.cat([state.elite_losses, losses])
        improved = state.iterations == 0 or bool(losses.min() < state.elite_losses.min())
        ranked = losses.argsort(stable=True)[: self.elite_size]
        return replace(
            state,
            iterations=state.iterations + 1,
            unchanged_iterations=0 if improved else state.unchanged_iterations + 1,
            candidates=self._breed(bits, losses, child_generator(state.seed, state.iterations)),
            elite=bits.index_select(0, ranked),
            elite_losses=losses[ranked],
        )

    def stop_reason(self, state: GeneticState) -> StopReason | None:
        """The paper's three rules; None while none of them holds."""
        if self.target is not None and bool((state.elite_losses < self.target).any()):
            return StopReason.TARGET
        if state.unchanged_iterations >= self.stagnation_iterations:
            return StopReason.STAGNATION
        if state.iterations >= self.largest_iterations:
            return StopReason.ITERATIONS
        return None

    def _breed(self, bits: Tensor, losses: Tensor, generator: torch.Generator) -> Tensor:
        """Children (population - elite, bit): selection, crossover, mutation."""
        children = self.population_size - self.elite_size
        # index_select stays on one thread; indexing with a tensor wakes all of them, which costs more than the generation.
        first, second = (bits.index_select(0, select_parents(losses, children, generator)) for _ in range(2))
        return mutate(
            cross_over(first, second, self.crossover_probability, generator), self.mutations / BITS, generator
        )
