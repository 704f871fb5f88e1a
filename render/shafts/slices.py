"""Epipolar slices of a sun's shadow map: planes that hold the eye and the sun, and cut the map in lines.

Seen from the sun, all rays of a slice run along one half-line from the eye. The cells of a slice are the pieces into which the borders of
the texels cut that half-line, so a look-up in a slice is one in the map. Its depth is the place along the sun's axis, counted away
from the sun.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.shafts.lit_intervals import LitIntervals
from render.shafts.minmax_tree import MinMaxTree, SliceRays, build_minmax_tree, find_lit_intervals
from render.shafts.rays import ViewRays
from render.shafts.shadow_map import ShadowMap

SLICES_AT_ONCE = 1 << 8
"""Slices cut at once: their borders are sorted within the cache."""


@dataclass(frozen=True, eq=False)
class Slices:
    """Slices of a map, and the direction of each over it.

    Args:
        tree: over the depths of the slices; places in texels from the eye.
        heading: unit vectors over the map `(slice, 2)`.
    """

    tree: MinMaxTree
    heading: Tensor


def build_slices(shadow_map: ShadowMap, eye: Tensor, heading: Tensor, longest: float) -> Slices:
    """Cut a map.

    Args:
        shadow_map: of the sun.
        eye: from which all rays begin `(3,)` [m].
        heading: unit vectors over the map `(slice, 2)`, float64.
        longest: length of the half-lines [texel].

    Returns:
        The slices.
    """
    start = (eye.double() @ shadow_map.axes.double().T)[:2]
    start = (start - shadow_map.lower.double()) / shadow_map.texel
    rows, columns = shadow_map.tops.shape
    depths, borders = [], []
    for part in heading.double().split(SLICES_AT_ONCE):
        crossings = [_crossings(start[axis], part[:, axis], size) for axis, size in ((0, columns), (1, rows))]
        edges = torch.cat([part.new_zeros(len(part), 1), *crossings, part.new_full((len(part), 1), longest)], dim=1)
        edges = edges.clamp(0.0, longest).sort(dim=1).values
        middle = 0.5 * (edges[:, 1:] + edges[:, :-1])
        cell = (start + middle[..., None] * part[:, None]).floor()
        inside = (cell >= 0).all(-1) & (cell[..., 0] < columns) & (cell[..., 1] < rows)
        index = cell[..., 1].clamp(0, rows - 1) * columns + cell[..., 0].clamp(0, columns - 1)
        tops = torch.where(inside, shadow_map.tops.reshape(-1)[index.long()], -math.inf)
        depths.append(-tops.double())
        borders.append(edges)
    return Slices(build_minmax_tree(torch.cat(depths), torch.cat(borders)), heading)


def _crossings(start: Tensor, heading: Tensor, size: int) -> Tensor:
    """Distances `(slice, size + 1)` [texel] at which half-lines cross the borders along one axis; those behind or never, at 0."""
    borders = torch.arange(size + 1, dtype=torch.float64) - start
    moving = heading != 0.0
    return torch.where(moving[:, None], borders / torch.where(moving, heading, 1.0)[:, None], 0.0)


def find_headings(shadow_map: ShadowMap, directions: Tensor) -> Tensor:
    """Unit vectors over the map `(ray, 2)`, float64, of ray directions `(ray, 3)`; any for a ray along the light."""
    flat = directions.double() @ shadow_map.axes[:2].double().T
    length = torch.linalg.vector_norm(flat, dim=1, keepdim=True)
    return torch.where(length > 0.0, flat / torch.where(length > 0.0, length, 1.0), flat.new_tensor([1.0, 0.0]))


def find_lit_parts(shadow_map: ShadowMap, slices: Slices, rays: ViewRays, slice_number: Tensor) -> LitIntervals:
    """Lit stretches of rays.

    Args:
        shadow_map: that the slices were cut from.
        slices: one for each heading.
        rays: all from the eye.
        slice_number: slice of each ray `(ray,)`; the ray is taken as lying in it.

    Returns:
        The stretches, as fractions of the rays.
    """
    axes = shadow_map.axes.double()
    first = rays.origin.double() @ axes[2]
    last = (rays.origin.double() + rays.distance.double()[:, None] * rays.direction.double()) @ axes[2]
    flat = rays.direction.double() @ axes[:2].T
    along = (flat * slices.heading[slice_number]).sum(1) * rays.distance.double() / shadow_map.texel
    along = along.clamp(min=0.0)
    return find_lit_intervals(slices.tree, SliceRays(slice_number, torch.zeros_like(along), along, -first, -last))
