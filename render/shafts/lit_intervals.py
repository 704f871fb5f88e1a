"""The stretches of many rays that the light reaches, as one flat list, and sums over them."""

from dataclasses import dataclass

import torch
from torch import Tensor

from render.errors import ParameterError


@dataclass(frozen=True, eq=False)
class LitIntervals:
    """Disjoint lit stretches of rays, in order of ray and place; neighbours that touch are one stretch.

    Args:
        ray: number of the ray each stretch belongs to `(interval,)`, int64, never falling.
        start, end: places where it begins and ends `(interval,)`, as fractions of the ray, 0 <= start < end <= 1.
        rays: number of rays; one that is all in shadow has no stretch.
    """

    ray: Tensor
    start: Tensor
    end: Tensor
    rays: int

    def lit_fraction(self) -> Tensor:
        """Lit part of each ray `(ray,)`, float64."""
        total = torch.zeros(self.rays, dtype=torch.float64, device=self.ray.device)
        return total.index_add_(0, self.ray, self.end.double() - self.start.double())

    def contains(self, places: Tensor) -> Tensor:
        """Which samples are lit.

        Args:
            places: fractions of the ray, rising, the same for all rays `(sample,)`.

        Returns:
            True where a stretch holds the place, its ends included `(ray, sample)`.
        """
        places = _require_rising(places, self.start)
        first = torch.searchsorted(places, self.start.contiguous())
        after = torch.searchsorted(places, self.end.contiguous(), right=True)
        change = torch.zeros(self.rays * (len(places) + 1), dtype=torch.int32, device=self.ray.device)
        row = self.ray * (len(places) + 1)
        one = torch.ones_like(self.ray, dtype=torch.int32)
        change.index_add_(0, row + first, one).index_add_(0, row + after, -one)
        return change.reshape(self.rays, -1)[:, :-1].cumsum(1) > 0

    def integrate(self, places: Tensor, cumulative: Tensor) -> Tensor:
        """Integral over the lit stretches of something whose integral along the whole ray is tabulated.

            sum over stretches of F(end) - F(start),   F linear between the places

        One table without shadows then serves every arrangement of them.

        Args:
            places: fractions of the ray at which F is given, from 0 to 1, rising, the same for all rays `(edge,)`.
            cumulative: F `(ray, edge, channel)`.

        Returns:
            The integral `(ray, channel)`, in the unit and the dtype of F; summed in float64.

        Raises:
            ParameterError: for shapes that do not belong together, or places that do not run from 0 to 1.
        """
        places = _require_rising(places, self.start)
        if cumulative.ndim != 3 or cumulative.shape[:2] != (self.rays, len(places)):
            raise ParameterError(
                f"the cumulative integral of {self.rays} rays at {len(places)} places has the shape (ray, edge, channel), "
                f"not {tuple(cumulative.shape)}"
            )
        if len(places) < 2 or float(places[0]) != 0.0 or float(places[-1]) != 1.0:
            raise ParameterError("the places of the cumulative integral must run from 0 to 1")
        table = cumulative.reshape(-1, cumulative.shape[2])
        amount = self._interpolate(places, table, self.end) - self._interpolate(places, table, self.start)
        total = amount.new_zeros(self.rays, table.shape[1])
        return total.index_add_(0, self.ray, amount).to(cumulative.dtype)

    def _interpolate(self, places: Tensor, table: Tensor, fraction: Tensor) -> Tensor:
        after = torch.searchsorted(places, fraction.contiguous(), right=True).clamp_(1, len(places) - 1)
        before = places[after - 1]
        weight = ((fraction - before) / (places[after] - before)).double()[:, None]
        row = self.ray * len(places) + after
        return torch.lerp(table.index_select(0, row - 1).double(), table.index_select(0, row).double(), weight)


def join_touching(ray: Tensor, start: Tensor, end: Tensor, rays: int) -> LitIntervals:
    """Put stretches in order and join those that end exactly where the next begins.

    Args:
        ray, start, end: stretches in any order, as in `LitIntervals`; they may touch but not overlap.
        rays: number of rays.

    Returns:
        The stretches.
    """
    order = torch.argsort(start, stable=True)
    order = order[torch.argsort(ray[order], stable=True)]
    ray, start, end = ray[order], start[order], end[order]
    touches = (ray[1:] == ray[:-1]) & (start[1:] == end[:-1])
    keep = torch.ones(1, dtype=torch.bool, device=ray.device)[: len(ray)]
    first, last = torch.cat([keep, ~touches]), torch.cat([~touches, keep])
    return LitIntervals(ray[first], start[first], end[last], rays)


def _require_rising(places: Tensor, like: Tensor) -> Tensor:
    places = places.to(like).contiguous()
    if places.ndim != 1 or not bool((places.diff() > 0.0).all()):
        raise ParameterError("places along a ray must be one row of rising fractions")
    return places
