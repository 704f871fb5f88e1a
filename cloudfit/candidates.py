"""The ranked list of distinct good answers: many parameter sets look alike, and a person should see the choice."""

import torch
from torch import Tensor

from render.errors import ParameterError

SEPARATION = 0.1
"""A tenth of a parameter's range: two answers that close in every parameter count as one."""

RELATIVE_EXCESS = 0.1


def distinct_candidates(
    evaluated: Tensor,
    losses: Tensor,
    count: int,
    separation: float = SEPARATION,
    relative_excess: float = RELATIVE_EXCESS,
    absolute_excess: float = 0.0,
) -> Tensor:
    """Indices of the best evaluations that differ from each other, best first.

    Greedy: the best evaluation is taken, all within `separation` of it (largest difference of any parameter) drop
    out, and so on. An evaluation worse than best + max(relative_excess |best|, absolute_excess) is never listed.

    Args:
        evaluated: (evaluation, parameter) in the unit cube.
        losses: (evaluation,); those that are not finite are left out.
        count: largest number of candidates.
        separation: smallest distance in the maximum norm between two candidates, in the unit cube.
        relative_excess: how much worse than the best a candidate may be, as a share of the best loss.
        absolute_excess: the same in units of the loss; the floor of the loss is a good choice.

    Returns:
        (candidate,) int64 indices into `evaluated`, at least one and at most `count`.

    Raises:
        ParameterError: when shapes do not fit, no loss is finite, or a number is out of its domain.
    """
    if evaluated.ndim != 2 or losses.shape != evaluated.shape[:1]:
        raise ParameterError(
            f"expected evaluated (evaluation, parameter) and losses (evaluation,), got {tuple(evaluated.shape)} and "
            f"{tuple(losses.shape)}"
        )
    if count < 1 or separation < 0 or relative_excess < 0 or absolute_excess < 0:
        raise ParameterError(
            "expected count >= 1 and separation, relative_excess, absolute_excess >= 0, got "
            f"{count}, {separation}, {relative_excess}, {absolute_excess}"
        )
    if not bool(losses.isfinite().any()):
        raise ParameterError(f"expected at least one finite loss among {len(losses)} evaluations, got none")
    best = float(losses[losses.isfinite()].min())
    good = losses.isfinite() & (losses <= best + max(relative_excess * abs(best), absolute_excess))
    # Stable: of equal losses the one evaluated first is listed.
    rest = torch.nonzero(good)[:, 0]
    rest = rest[losses[rest].argsort(stable=True)]
    chosen: list[Tensor] = []
    while len(rest) and len(chosen) < count:
        chosen.append(rest[0])
        distance = (evaluated[rest] - evaluated[rest[0]]).abs().amax(dim=1)
        # The point itself leaves even when no separation is asked for.
        keep = (distance >= separation) & (torch.arange(len(rest)) > 0)
        rest = rest[keep]
    return torch.stack(chosen)
