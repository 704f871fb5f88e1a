"""Lit stretches of rays from one eye: slices of a shadow map, cut at the borders of its texels, and their min-max trees.

Seen from the light, all camera rays of an epipolar slice run along one half-line from the eye. The borders of the texels cut it
into cells, so that a look-up in the slice is the same as one in the map, by the nearest texel.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from render.errors import ParameterError
from render.fused import fused_loops_wanted
from render.shafts.lit_intervals import LitIntervals
from render.shafts.minmax_tree import SliceRays, build_minmax_tree, find_lit_intervals

SLICES_AT_ONCE = 1 << 8
"""Slices cut at once: their borders are sorted within the cache."""


@dataclass(frozen=True, eq=False)
class MapSlices:
    """Half-lines over a shadow map.

    Args:
        depths: depth of the first surface that the light meets in each texel `(row, column)`, growing away from the light;
            infinite for none.
        start: column and row of the eye over the map, 0 at the outer border of the first texel `(2,)` [texel].
        heading: unit vectors along columns and rows `(slice, 2)`.

    Raises:
        ParameterError: for another shape, NaN, or a start or a heading that is not finite.
    """

    depths: Tensor
    start: Tensor
    heading: Tensor

    def __post_init__(self) -> None:
        if self.depths.ndim != 2 or self.depths.numel() == 0 or bool(self.depths.isnan().any()):
            raise ParameterError(f"a shadow map has the shape (row, column) and no NaN, not {tuple(self.depths.shape)}")
        finite = bool(torch.isfinite(self.start).all() & torch.isfinite(self.heading).all())
        if self.start.shape != (2,) or self.heading.ndim != 2 or self.heading.shape[1] != 2 or not finite:
            raise ParameterError("slices of a map need a finite start (2,) and finite headings (slice, 2)")


def cut_map(slices: MapSlices, longest: float) -> tuple[Tensor, Tensor]:
    """Depths along half-lines.

    Args:
        slices: the half-lines.
        longest: how far they are followed [texel].

    Returns:
        Depths of the cells `(slice, cell)` and their borders `(slice, cell + 1)` [texel from the eye], never falling, both in
        float64; as many for each slice, some of them without extent. Cells outside of the map have an infinite depth.
    """
    rows, columns = slices.depths.shape
    start = slices.start.double()
    depths, edges = [], []
    for heading in slices.heading.double().split(SLICES_AT_ONCE):
        crossings = [_crossings(start[axis], heading[:, axis], size) for axis, size in ((0, columns), (1, rows))]
        ends = [heading.new_zeros(len(heading), 1), heading.new_full((len(heading), 1), longest)]
        border = torch.cat([ends[0], *crossings, ends[1]], dim=1).clamp(0.0, longest).sort(dim=1).values
        middle = 0.5 * (border[:, 1:] + border[:, :-1])
        column, row = (start + middle[..., None] * heading[:, None]).floor().long().unbind(-1)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        texel = row.clamp(0, rows - 1) * columns + column.clamp(0, columns - 1)
        depths.append(torch.where(inside, slices.depths.reshape(-1)[texel].double(), torch.inf))
        edges.append(border)
    return torch.cat(depths), torch.cat(edges)


def _crossings(start: Tensor, heading: Tensor, size: int) -> Tensor:
    """Distances `(slice, size + 1)` at which half-lines cross the borders along one axis; 0 for those along the borders."""
    borders = torch.arange(size + 1, dtype=torch.float64, device=start.device) - start
    moving = heading[:, None] != 0.0
    return torch.where(moving, borders / torch.where(moving, heading[:, None], 1.0), 0.0)


def find_lit_in_map(slices: MapSlices, rays: SliceRays) -> LitIntervals:
    """Lit stretches of rays over a map.

    Args:
        slices: one half-line for each slice number of the rays.
        rays: in float64, with places at least 0 [texel from the eye], depths in the unit of the map.

    Returns:
        The stretches, as fractions of each ray; what lies outside of the map is lit.

    Raises:
        ParameterError: for rays of another precision, behind the eye, or of a slice that is not there.
    """
    if not len(rays.slice_number):
        none = rays.start_place
        return LitIntervals(rays.slice_number, none, none, 0)
    if rays.start_place.dtype != torch.float64 or bool((torch.minimum(rays.start_place, rays.end_place) < 0.0).any()):
        raise ParameterError("rays over a map need float64 and places that are not behind the eye")
    if not 0 <= int(rays.slice_number.min()) <= int(rays.slice_number.max()) < len(slices.heading):
        raise ParameterError(
            f"there are {len(slices.heading)} slices, but rays of slice {int(rays.slice_number.max())}"
        )
    if fused_loops_wanted(slices.depths, slices.heading, rays.start_place, rays.end_depth):
        from render.shafts.fused_map_slices import find_lit_slice_by_slice  # needs numba

        return find_lit_slice_by_slice(slices, rays)
    depths, edges = cut_map(slices, float(torch.maximum(rays.start_place, rays.end_place).max()))
    return find_lit_intervals(build_minmax_tree(depths, edges), rays)
