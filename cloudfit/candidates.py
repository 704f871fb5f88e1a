"""The ranked list of distinct good answers: many parameter sets look alike, and a person should see the choice."""

from collections.abc import Callable

import torch
from torch import Tensor

from render.errors import ParameterError

SEPARATION = 0.1
"""A tenth of a parameter's range: two answers that close in every parameter count as one."""

RELATIVE_EXCESS = 0.1
"""Answers whose loss exceeds the best by less than this share of it are nearly as good."""

VISIBLE_LEVELS = 1.0
"""Smallest RMS difference of two images, in display levels, for which a parameter has done something."""

Appearance = Callable[[Tensor], Tensor]
"""(population, parameter) in the unit cube -> (population, feature) display levels 0..255 of what the candidates look like."""


def nearly_best(losses: Tensor, relative_excess: float = RELATIVE_EXCESS, absolute_excess: float = 0.0) -> Tensor:
    """Which evaluations are nearly as good as the best: loss <= best + max(relative_excess |best|, absolute_excess).

    Args:
        losses: (evaluation,), at least one of them finite; those that are not are left out.
        relative_excess: how much worse than the best, as a share of the best loss.
        absolute_excess: the same in units of the loss; the floor of the loss is a good choice.

    Returns:
        (evaluation,) bool.

    Raises:
        ParameterError: when no loss is finite.
    """
    finite = losses.isfinite()
    if not bool(finite.any()):
        raise ParameterError(f"expected at least one finite loss among {len(losses)} evaluations, got none")
    best = float(losses[finite].min())
    return finite & (losses <= best + max(relative_excess * abs(best), absolute_excess))


def distinct_candidates(
    evaluated: Tensor,
    losses: Tensor,
    count: int,
    separation: float = SEPARATION,
    relative_excess: float = RELATIVE_EXCESS,
    absolute_excess: float = 0.0,
    appearance: Appearance | None = None,
) -> Tensor:
    """Indices of the best evaluations that differ from each other, best first.

    Clusters around leaders: the best evaluation leads the first cluster, which takes all within `separation` of it (largest
    difference of any parameter); the best of the rest leads the next, and so on. With an appearance, a leader is listed only if
    it differs from every one listed by a parameter that does something: taking over that parameter from the one
    to the other must be visible in at least one of both. The sun's intensity in front of a black cloud is no difference.
    An evaluation that is not `nearly_best` is never listed.

    Args:
        evaluated: (evaluation, parameter) in the unit cube.
        losses: (evaluation,); those that are not finite are left out.
        count: largest number of candidates.
        separation: smallest distance in the maximum norm between two candidates, in the unit cube.
        relative_excess, absolute_excess: of `nearly_best`.
        appearance: what candidates look like.

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
    good = nearly_best(losses, relative_excess, absolute_excess)
    # Stable: of equal losses the one evaluated first is listed.
    rest = torch.nonzero(good)[:, 0]
    rest = rest[losses[rest].argsort(stable=True)]
    chosen: list[Tensor] = []
    while len(rest) and len(chosen) < count:
        leader = rest[0]
        if all(_differ(evaluated[other], evaluated[leader], separation, appearance) for other in chosen):
            chosen.append(leader)
        distance = (evaluated[rest] - evaluated[leader]).abs().amax(dim=1)
        # The point itself leaves even when no separation is asked for.
        keep = (distance >= separation) & (torch.arange(len(rest)) > 0)
        rest = rest[keep]
    return torch.stack(chosen)


def _differ(first: Tensor, second: Tensor, separation: float, appearance: Appearance | None) -> bool:
    """Whether two points `(parameter,)` differ by `separation` in a parameter that can be seen in one of them."""
    if appearance is None:
        return True
    apart = torch.nonzero((first - second).abs() >= separation)[:, 0]
    moved_first, moved_second = first.repeat(len(apart), 1), second.repeat(len(apart), 1)
    rows = torch.arange(len(apart))
    moved_first[rows, apart], moved_second[rows, apart] = second[apart], first[apart]
    levels = appearance(torch.cat([first[None], second[None], moved_first, moved_second]))
    change = torch.cat([levels[2 : 2 + len(apart)] - levels[0], levels[2 + len(apart) :] - levels[1]])
    return bool((change.square().mean(dim=1).sqrt() >= VISIBLE_LEVELS).any())
