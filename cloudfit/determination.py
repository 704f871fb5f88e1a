"""Which parameters a photograph determines: how far each can go while the answer stays nearly as good."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from cloudfit.candidates import SEPARATION, nearly_best
from cloudfit.parameters import SearchSpace
from render.errors import ParameterError

DETERMINED_SHARE = 2.0 * SEPARATION
"""Of a parameter's range: nearly equal answers that spread over more leave it open. Two that close to the best count as one answer."""

WALK_STEPS = 10
"""Equal steps over the whole range of a parameter; no coarser than `SEPARATION`, so that no spread that matters is stepped over."""


CHAINS, GENERATIONS = 20, 12
"""Of the exploration; as many evaluations as a twentieth of a default search."""

STRETCH = (0.5, 2.0)
"""Range of the factors on a difference between two chains: those above one let a group that lies close together spread along a valley."""

JITTER = (1e-4, 2e-2)
"""Smallest and largest standard deviation, in the unit cube, of what is added to a step: for narrow valleys and to leave a single point."""


@dataclass(frozen=True)
class ParameterSpread:
    """How far one parameter varies among nearly equal answers.

    Args:
        name: of the parameter.
        lowest, highest: value among these answers [unit of the parameter].
        share: of the searched range between the two, on the parameter's own scale.
    """

    name: str
    lowest: float
    highest: float
    share: float

    @property
    def is_determined(self) -> bool:
        """Whether the photograph determines the parameter."""
        return self.share <= DETERMINED_SHARE


@dataclass(frozen=True)
class Determination:
    """What nearly equal answers have in common.

    Args:
        parameters: spread of each, in the order of the search space.
        answers: number of nearly equal answers that were found.
        excess: loss above the best up to which an answer counts as nearly equal.
    """

    parameters: tuple[ParameterSpread, ...]
    answers: int
    excess: float


def walk_through(best: Tensor) -> Tensor:
    """Points that differ from the best in one parameter, which goes through its range in equal steps.

    A search that has converged no longer tries what makes no difference; this does.

    Args:
        best: (parameter,) in the unit cube.

    Returns:
        (parameter x (`WALK_STEPS` + 1), parameter).
    """
    places = torch.linspace(0.0, 1.0, WALK_STEPS + 1, dtype=best.dtype)
    points = best.repeat(len(best), len(places), 1)
    for number in range(len(best)):
        points[number, :, number] = places
    return points.flatten(0, 1)


def explore(
    objective: Callable[[Tensor], Tensor], points: Tensor, losses: Tensor, absolute_excess: float, seed: int
) -> tuple[Tensor, Tensor]:
    """Wander through the set of nearly equal answers, along its valleys, where several parameters make up for each other.

    Chains that start far from each other and move by differences of other chains, x_i + f (x_j - x_k) + noise, as long as the answer
    stays nearly best: the differential evolution Markov chain of ter Braak 2006 for a density that is constant on that set
    (its factor f is drawn here, see `STRETCH`). The differences have the shape of the set, so the steps follow it.

    Args:
        objective: (population, parameter) -> (population,).
        points: (evaluation, parameter) in the unit cube.
        losses: (evaluation,), at least one finite.
        absolute_excess: of `nearly_best`.
        seed: of the steps.

    Returns:
        All points tried, those given included, and their losses.
    """
    generator = torch.Generator().manual_seed(seed)
    good = points[nearly_best(losses, absolute_excess=absolute_excess)]
    chains = good[_far_apart(good, CHAINS)]
    chains = chains.repeat(-(-CHAINS // len(chains)), 1)[:CHAINS]
    for _ in range(GENERATIONS):
        others = torch.stack([torch.randperm(CHAINS, generator=generator) for _ in range(2)])
        factor = STRETCH[0] + (STRETCH[1] - STRETCH[0]) * torch.rand(CHAINS, 1, generator=generator)
        size = JITTER[0] * (JITTER[1] / JITTER[0]) ** torch.rand(CHAINS, 1, generator=generator)
        noise = size * torch.randn(chains.shape, generator=generator)
        tried = (chains + factor * (chains[others[0]] - chains[others[1]]) + noise).clamp(0.0, 1.0)
        points, losses = torch.cat([points, tried]), torch.cat([losses, objective(tried).double()])
        stays = nearly_best(losses, absolute_excess=absolute_excess)[-CHAINS:]
        chains = torch.where(stays[:, None], tried, chains)
    return points, losses


def _far_apart(points: Tensor, count: int) -> Tensor:
    """Indices of points `(point, parameter)` each of which is the farthest from those before, in the maximum norm."""
    chosen = [torch.zeros((), dtype=torch.int64)]
    nearest = torch.full((len(points),), torch.inf)
    for _ in range(min(count, len(points)) - 1):
        nearest = nearest.minimum((points - points[chosen[-1]]).abs().amax(dim=1))
        chosen.append(nearest.argmax())
    return torch.stack(chosen)


def measure_determination(
    objective: Callable[[Tensor], Tensor],
    space: SearchSpace,
    evaluated: Tensor,
    losses: Tensor,
    absolute_excess: float,
    seed: int = 0,
) -> Determination:
    """Spread of each parameter among all nearly equal answers that were met: by the search, on a walk through each parameter, and beyond.

    A search ends in one place of a valley, so it is followed by `walk_through` from the best and by `explore`. What was not tried
    is not known: the true spread is at least what is returned.

    Args:
        objective: (population, parameter) -> (population,).
        space: that was searched.
        evaluated: (evaluation, parameter) in the unit cube, the whole search.
        losses: (evaluation,), at least one finite.
        absolute_excess: of `nearly_best`.
        seed: of the exploration.

    Returns:
        The spreads.

    Raises:
        ParameterError: when shapes do not fit or no loss is finite.
    """
    if evaluated.shape != (len(losses), space.dimension):
        raise ParameterError(
            f"expected evaluated (evaluation, parameter) = ({len(losses)}, {space.dimension}), got {tuple(evaluated.shape)}"
        )
    best = evaluated[losses.nan_to_num(nan=torch.inf).argmin()]
    walked = walk_through(best)
    points = torch.cat([evaluated, walked])
    values = torch.cat([losses.double(), objective(walked).double()])
    points, values = explore(objective, points, values, absolute_excess, seed)
    good = nearly_best(values, absolute_excess=absolute_excess)
    low, high = points[good].aminmax(dim=0)
    ends = space.to_physical(torch.stack([low, high]).double())
    spreads = zip(space.names, *ends.tolist(), (high - low).tolist(), strict=True)
    return Determination(
        tuple(ParameterSpread(*spread) for spread in spreads),
        int(good.sum()),
        float(values[good].max() - values[good].min()),
    )
