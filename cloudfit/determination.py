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


def measure_determination(
    objective: Callable[[Tensor], Tensor],
    space: SearchSpace,
    evaluated: Tensor,
    losses: Tensor,
    absolute_excess: float,
) -> Determination:
    """Spread of each parameter among all nearly equal answers that a search has met, and those of a walk through each from the best.

    What was not tried is not known: the true spread is at least what is returned.

    Args:
        objective: (population, parameter) -> (population,).
        space: that was searched.
        evaluated: (evaluation, parameter) in the unit cube, the whole search.
        losses: (evaluation,), at least one finite.
        absolute_excess: of `nearly_best`.

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
    good = nearly_best(values, absolute_excess=absolute_excess)
    low, high = points[good].aminmax(dim=0)
    ends = space.to_physical(torch.stack([low, high]).double())
    spreads = zip(space.names, *ends.tolist(), (high - low).tolist(), strict=True)
    return Determination(
        tuple(ParameterSpread(*spread) for spread in spreads),
        int(good.sum()),
        float(values[good].max() - values[good].min()),
    )
