"""Where to sample along a camera ray: many short steps near the eye, few long ones far away.

Tan et al. 2020, "Adaptive volumetric light and atmospheric scattering", algorithm 1: a ray is cut at a distance from the
eye; the near part has equal steps, the far part steps that grow in proportion to their number,

    far step i = R 2 (i + 1) / (T2 (T2 + 1)),   i = 0 .. T2 - 1

where R is the length of the far part and T2 the number of its steps. The numbers 1 + 2 + ... + T2 = T2 (T2 + 1) / 2 make the
steps tile R; the rule as printed does not. Counted without the one beside i, for example, 2 / (T2 + 1) of R stay uncovered.

The first far step of that rule has nothing to do with the last near one. With the smooth transition the far steps start
from the near step s and grow from there,

    far step i = s + (R - T2 s) 2 (i + 1) / (T2 (T2 + 1))

with s at most R / T2, so that no step is negative; s = 0 is the rule above.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.errors import ParameterError

MOST_STEPS = 1 << 16
"""More steps than this are a mistake: a shadow map has fewer texels along any line."""


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps of rays, and a sample in the middle of each.

    Args:
        edges: distances from the eye at which steps begin and end `(ray, step + 1)` [m]; a step may have no length.
    """

    edges: Tensor

    @property
    def lengths(self) -> Tensor:
        """Length of each step `(ray, step)` [m]: the weight of its sample in an integral over distance."""
        return self.edges.diff(dim=1)

    @property
    def samples(self) -> Tensor:
        """Distance from the eye to the middle of each step `(ray, step)` [m]."""
        return torch.lerp(self.edges[:, :-1], self.edges[:, 1:], 0.5)


@dataclass(frozen=True)
class StepSchedule:
    """Two levels of distance with their numbers of steps.

    Args:
        near_steps: equal steps of the near part, T1.
        far_steps: growing steps of the far part, T2; none if the ray is all near.
        near_distance: distance from the eye at which the far part begins [m]; infinite if the ray is all near.
        smooth_transition: let the far steps grow from the near step instead of from zero.

    Raises:
        ParameterError: for no steps at all, a part without steps, or a distance that is not positive.
    """

    near_steps: int
    far_steps: int
    near_distance: float
    smooth_transition: bool = True

    def __post_init__(self) -> None:
        if not (1 <= self.near_steps <= MOST_STEPS and 0 <= self.far_steps <= MOST_STEPS):
            raise ParameterError(
                f"a ray needs from 1 to {MOST_STEPS} near steps and at most as many far ones, "
                f"not {self.near_steps} and {self.far_steps}"
            )
        if not self.near_distance > 0.0:
            raise ParameterError(f"the near part of a ray needs a positive length [m], not {self.near_distance}")
        if (self.far_steps == 0) != math.isinf(self.near_distance):
            raise ParameterError("a ray without far steps is near to infinity, and only such a ray has none")

    @property
    def steps(self) -> int:
        """Steps of a ray."""
        return self.near_steps + self.far_steps

    @classmethod
    def uniform(cls, steps: int) -> "StepSchedule":
        """Equal steps, whatever the distance."""
        return cls(steps, 0, math.inf)

    @classmethod
    def from_ratio(
        cls, steps: int, near_ratio: float, far_ratio: float, near_distance: float, *, smooth_transition: bool = True
    ) -> "StepSchedule":
        """Share steps between the levels.

        Args:
            steps: of the whole ray, at least 2.
            near_ratio, far_ratio: share of each level, positive, in any unit: 3 and 1 give the near part three quarters.
            near_distance: distance from the eye at which the far part begins [m].
            smooth_transition: see the class.

        Returns:
            A schedule of just as many steps, at least one in each level.

        Raises:
            ParameterError: for fewer than two steps, or ratios that are not positive.
        """
        if steps < 2:
            raise ParameterError(f"two levels need at least 2 steps, not {steps}")
        if not (0.0 < near_ratio < math.inf and 0.0 < far_ratio < math.inf):
            raise ParameterError(f"the ratios of the levels must be positive, not {near_ratio} and {far_ratio}")
        near = min(max(round(steps * near_ratio / (near_ratio + far_ratio)), 1), steps - 1)
        return cls(near, steps - near, near_distance, smooth_transition)

    def tile(self, start: Tensor, end: Tensor) -> Steps:
        """Steps that tile the stretch of each ray from `start` to `end`, exactly.

        Args:
            start, end: distances from the eye `(ray,)` [m], finite, 0 <= start <= end.

        Returns:
            As many steps for each ray. Where the stretch ends in the near part or begins in the far one, the steps of the
            other part have no length.

        Raises:
            ParameterError: for a stretch that is not one.
        """
        if not bool((torch.isfinite(end) & (start >= 0.0) & (start <= end)).all()):
            raise ParameterError("steps tile stretches from a start >= 0 to a finite end that is not before it")
        border = torch.minimum(torch.maximum(start, torch.full_like(start, self.near_distance)), end)
        share = torch.arange(self.near_steps + 1, dtype=start.dtype, device=start.device) / self.near_steps
        near = torch.lerp(start[:, None], border[:, None], share)
        if not self.far_steps:
            return Steps(near)
        first = (border - start) / self.near_steps if self.smooth_transition else torch.zeros_like(start)
        far = torch.lerp(border[:, None], end[:, None], self._far_shares(first, end - border))
        return Steps(torch.cat([near, far], dim=1))

    def _far_shares(self, first: Tensor, length: Tensor) -> Tensor:
        """Ends of the far steps as fractions of the far part `(ray, far step)`; the last one is 1, exactly."""
        count = self.far_steps
        number = torch.arange(1, count + 1, dtype=length.dtype, device=length.device)
        even, growing = number / count, number * (number + 1.0) / (count * (count + 1.0))
        # Share of the far part that equal steps of the near length would cover: all of it if the near step is too long.
        covered = torch.where(length > 0.0, count * first / length, 1.0).clamp(max=1.0)
        return torch.lerp(growing, even, covered[:, None])


def count_needed_steps(optical_depth: Tensor, smallest_transmittance: float) -> int:
    """Number of leading steps after which no ray lets through as much as a given transmittance.

    Args:
        optical_depth: from the eye to the end of each step, never falling `(ray, step)`.
        smallest_transmittance: what may be left out, relative to what lies behind; 0 keeps every step
            that lets through any light at all in the precision of `optical_depth`.

    Returns:
        Steps that matter, from 0 to all.

    Raises:
        ParameterError: for a transmittance outside 0..1.
    """
    if not 0.0 <= smallest_transmittance <= 1.0:
        raise ParameterError(f"a transmittance lies within 0..1, but {smallest_transmittance} was asked for")
    before = torch.nn.functional.pad(optical_depth[:, :-1], (1, 0))
    matters = torch.exp(-before) > smallest_transmittance
    return int(matters.any(0).sum())
