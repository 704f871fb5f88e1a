"""View rays of known length, and the borders of the steps along them."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class ViewRays:
    """Rays from the eye to the first surface.

    Args:
        origin: `(ray, 3)` [m].
        direction: unit vectors `(ray, 3)`.
        distance: lengths `(ray,)` [m], finite.
    """

    origin: Tensor
    direction: Tensor
    distance: Tensor

    def __len__(self) -> int:
        """Number of rays."""
        return len(self.distance)

    def __getitem__(self, chosen: slice | Tensor) -> "ViewRays":
        """Some of the rays."""
        return ViewRays(self.origin[chosen], self.direction[chosen], self.distance[chosen])

    def points_at(self, distance: Tensor) -> Tensor:
        """Points `(ray, sample, 3)` [m] at distances `(ray, sample)` [m]."""
        return self.origin[:, None] + distance[..., None] * self.direction[:, None]

    def doubled(self) -> "ViewRays":
        """The same rays in float64."""
        return ViewRays(self.origin.double(), self.direction.double(), self.distance.double())


def uniform_edges(rays: ViewRays, steps: int) -> Tensor:
    """Borders `(ray, step + 1)` [m] of equal steps along each ray."""
    share = torch.arange(steps + 1, dtype=rays.distance.dtype, device=rays.distance.device) / steps
    return rays.distance[:, None] * share


def shifted_edges(rays: ViewRays, steps: int, shift: float) -> Tensor:
    """Borders `(ray, step + 2)` [m] of equal steps that begin a share of a step, 0..1, before the ray does; both end ones are cut."""
    share = (torch.arange(steps + 2, dtype=rays.distance.dtype, device=rays.distance.device) - shift) / steps
    return rays.distance[:, None] * share.clamp(0.0, 1.0)
