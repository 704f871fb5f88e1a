"""Which stretches of camera rays are lit: a binary tree of least and greatest depths over a slice of the shadow map.

An epipolar slice is a plane that holds the eye and the light. It cuts the shadow map in a line, and along that line the
map is a row of depths, the same for all camera rays of the slice. A ray is a straight segment above that row; it is lit
where it is nearer to the light than the row. Each node of the tree knows the least and the greatest depth of its cells, so
a stretch of the ray is lit as a whole if it lies before the least one, and in shadow if it lies behind the greatest; only
mixed nodes are opened. Chen, Baran, Durand & Jarosz 2011, "Real-time volumetric shadows using 1D min-max mipmaps"; without
rectifying the map as in Tan et al. 2020, "Adaptive volumetric light and atmospheric scattering" (visible factor culling).

Depth is any quantity that grows away from the light and is linear along camera rays in the place of the slice: the distance
along the light's direction for the sun, minus the inverse distance along the axis of a face of a cube map.

Equal to a linear scan in every bit, because the depth of a ray at an edge is computed by one formula that rounding keeps
monotone: what holds at the ends of a node holds at all edges between them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from render.errors import ParameterError
from render.fused import fused_loops_wanted
from render.shafts.lit_intervals import LitIntervals, join_touching

RAYS_IN_FLIGHT = 1 << 16
"""Rays that walk down the tree together: their nodes stay within the cache."""

CELLS_IN_FLIGHT = 1 << 20
"""Pairs of ray and cell of the linear scan at once: bounds the memory."""


@dataclass(frozen=True, eq=False)
class MinMaxTree:
    """Least and greatest depth of 1, 2, 4... cells of each slice; `build_minmax_tree` makes one.

    Args:
        edges: places that bound the cells `(slice, cell + 1)`; the first and the last are infinite, for outside of the map
            nothing casts a shadow.
        minimum, maximum: depths of all nodes `(slice, 2 cell)`: the root at 1, the halves of node n at 2 n and 2 n + 1, so
            that the cells come last; 0 is not used. The number of cells is a power of two.
    """

    edges: Tensor
    minimum: Tensor
    maximum: Tensor

    @property
    def cells(self) -> int:
        """Cells of a slice, those outside of the map included."""
        return self.edges.shape[1] - 1


@dataclass(frozen=True, eq=False)
class SliceRays:
    """Camera rays as segments above the depths of their slices.

    Args:
        slice_number: slice of each ray `(ray,)`, int64.
        start_place, end_place: where it begins and ends along the slice `(ray,)`, in the unit of the edges; the same
            for a ray along the light.
        start_depth, end_depth: its depth there `(ray,)`, in the unit of the tree's depths.

    Raises:
        ParameterError: for numbers that are not finite, or shapes that differ.
    """

    slice_number: Tensor
    start_place: Tensor
    end_place: Tensor
    start_depth: Tensor
    end_depth: Tensor

    def __post_init__(self) -> None:
        numbers = (self.start_place, self.end_place, self.start_depth, self.end_depth)
        shapes = {tuple(number.shape) for number in (self.slice_number, *numbers)}
        if len(shapes) != 1 or self.slice_number.ndim != 1:
            raise ParameterError(
                f"the ends of rays above slices need one row of equal length each, not {sorted(shapes)}"
            )
        if not all(bool(torch.isfinite(number).all()) for number in numbers):
            raise ParameterError("the ends of a ray above a slice must be finite; cut the ray before the tree is asked")

    def chosen(self, rays: slice) -> "SliceRays":
        """Some of the rays."""
        return SliceRays(
            self.slice_number[rays],
            self.start_place[rays],
            self.end_place[rays],
            self.start_depth[rays],
            self.end_depth[rays],
        )

    def fraction_at(self, edge: Tensor, ray: Tensor) -> Tensor:
        """Fraction of rays `(pair,)` at which they pass edges `(pair,)`, held within 0..1; 0 or 1 for a ray along the light."""
        start = self.start_place[ray]
        extent = self.end_place[ray] - start
        along_light = torch.where(edge > start, 1.0, 0.0).to(start.dtype)
        return torch.where(extent == 0.0, along_light, ((edge - start) / extent).clamp(0.0, 1.0))

    def depth_at(self, fraction: Tensor, ray: Tensor) -> Tensor:
        """Depth of rays at fractions of their lengths, both `(pair,)`."""
        start = self.start_depth[ray]
        return start + fraction * (self.end_depth[ray] - start)


def build_minmax_tree(depths: Tensor, edges: Tensor | None = None) -> MinMaxTree:
    """Tree over the depths of slices.

    Args:
        depths: depth of the first thing that the light meets in each cell `(slice, cell)`; infinite where it meets nothing.
        edges: places that bound the cells, never falling `(slice, cell + 1)`; without them cell i reaches from i to i + 1.

    Returns:
        The tree; what lies outside of the edges is lit.

    Raises:
        ParameterError: for NaN, a wrong shape, or edges that fall or are not finite.
    """
    if depths.ndim != 2 or depths.shape[1] == 0 or bool(depths.isnan().any()):
        raise ParameterError(f"depths of slices need the shape (slice, cell) and no NaN, not {tuple(depths.shape)}")
    slices, cells = depths.shape
    if edges is None:
        edges = torch.arange(cells + 1, dtype=depths.dtype, device=depths.device).expand(slices, -1)
    if edges.shape != (slices, cells + 1):
        raise ParameterError(f"{slices} slices of {cells} cells need {cells + 1} edges each, not {tuple(edges.shape)}")
    if not bool(torch.isfinite(edges).all()) or not bool((edges.diff(dim=1) >= 0.0).all()):
        raise ParameterError("the edges of the cells of a slice must be finite and must not fall")
    # One cell of nothing on either side, then cells without extent up to a power of two.
    missing = (1 << (cells + 1).bit_length()) - cells - 1
    pad = torch.nn.functional.pad
    edges = pad(pad(edges, (1, 0), value=-torch.inf), (0, missing), value=torch.inf)
    border = pad(pad(depths, (1, 0), value=torch.inf), (0, 1), value=torch.inf)
    minimum = _fill_nodes(pad(border, (0, missing - 1), value=torch.inf), torch.minimum)
    maximum = _fill_nodes(pad(border, (0, missing - 1), value=-torch.inf), torch.maximum)
    return MinMaxTree(edges.contiguous(), minimum, maximum)


def _fill_nodes(leaves: Tensor, better: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    cells = leaves.shape[1]
    nodes = torch.cat([torch.zeros_like(leaves), leaves], dim=1)
    while cells > 1:
        pairs = nodes[:, cells : 2 * cells].unflatten(1, (-1, 2))
        cells //= 2
        nodes[:, cells : 2 * cells] = better(pairs[..., 0], pairs[..., 1])
    return nodes


@dataclass(frozen=True, eq=False)
class _Stretches:
    """Pairs of a ray and a run of cells, with the fractions at which the ray enters and leaves the run, and its depths there."""

    ray: Tensor
    node: Tensor
    enter: Tensor
    leave: Tensor
    enter_depth: Tensor
    leave_depth: Tensor

    def chosen(self, mask: Tensor) -> "_Stretches":
        return _Stretches(
            self.ray[mask],
            self.node[mask],
            self.enter[mask],
            self.leave[mask],
            self.enter_depth[mask],
            self.leave_depth[mask],
        )


def find_lit_intervals(tree: MinMaxTree, rays: SliceRays) -> LitIntervals:
    """Lit stretches of all rays of all slices, by walking down the tree with all of them at once.

    Args:
        tree: of the slices.
        rays: whose ends lie in those slices.

    Returns:
        The stretches, as fractions of each ray. A place is lit where its depth does not exceed that of its cell.

    Raises:
        ParameterError: for a ray of a slice that the tree does not have.
    """
    _check_slices(tree, rays)
    ends = (rays.start_place, rays.end_place, rays.start_depth, rays.end_depth)
    same = all(number.dtype == tree.edges.dtype == tree.minimum.dtype for number in ends)
    if same and fused_loops_wanted(tree.edges, tree.minimum, *ends):
        from render.shafts.fused_minmax_tree import walk_down  # needs numba

        return walk_down(tree, rays)
    found: list[tuple[Tensor, Tensor, Tensor]] = []
    count = len(rays.slice_number)
    for first in range(0, count, RAYS_IN_FLIGHT):
        part = rays.chosen(slice(first, min(first + RAYS_IN_FLIGHT, count)))
        found += [(ray + first, start, end) for ray, start, end in _walk_down(tree, part)]
    return _collect(found, rays)


def scan_lit_intervals(tree: MinMaxTree, rays: SliceRays) -> LitIntervals:
    """The same by trying every ray against every cell of its slice: the reference that the tree is equal to."""
    _check_slices(tree, rays)
    cells = tree.cells
    count, chunk = len(rays.slice_number), max(1, CELLS_IN_FLIGHT // cells)
    found = []
    for first in range(0, count, chunk):
        part = rays.chosen(slice(first, min(first + chunk, count)))
        ray = torch.arange(len(part.slice_number), device=tree.edges.device).repeat_interleave(cells)
        cell = torch.arange(cells, device=ray.device).repeat(len(part.slice_number))
        start_ray, start, end = _cut_leaves(tree, part, _measure(tree, part, ray, cell, 0))
        found.append((start_ray + first, start, end))
    return _collect(found, rays)


def _check_slices(tree: MinMaxTree, rays: SliceRays) -> None:
    slices, numbers = len(tree.edges), rays.slice_number
    if len(numbers) and not 0 <= int(numbers.min()) <= int(numbers.max()) < slices:
        raise ParameterError(f"the tree has the slices 0..{slices - 1}, but a ray lies in slice {int(numbers.max())}")


def _collect(found: list[tuple[Tensor, Tensor, Tensor]], rays: SliceRays) -> LitIntervals:
    if not found:
        none = rays.start_place.new_zeros(0)
        return LitIntervals(rays.slice_number.new_zeros(0), none, none, 0)
    ray, start, end = (torch.cat(parts) for parts in zip(*found, strict=True))
    return join_touching(ray, start, end, len(rays.slice_number))


def _walk_down(tree: MinMaxTree, rays: SliceRays) -> list[tuple[Tensor, Tensor, Tensor]]:
    """Lit stretches of the nodes that are lit as a whole, and of the leaves that are lit in part."""
    lit = []
    ray = torch.arange(len(rays.slice_number), device=tree.edges.device)
    node = torch.zeros_like(ray)
    for level in range(tree.cells.bit_length() - 1, 0, -1):
        run = _measure(tree, rays, ray, node, level)
        place = rays.slice_number[run.ray], (tree.cells >> level) + run.node
        whole = torch.maximum(run.enter_depth, run.leave_depth) <= tree.minimum[place]
        dark = torch.minimum(run.enter_depth, run.leave_depth) > tree.maximum[place]
        lit.append((run.ray[whole], run.enter[whole], run.leave[whole]))
        mixed = run.chosen(~(whole | dark))
        ray = mixed.ray.repeat_interleave(2)
        node = torch.stack([2 * mixed.node, 2 * mixed.node + 1], dim=1).reshape(-1)
    lit.append(_cut_leaves(tree, rays, _measure(tree, rays, ray, node, 0)))
    return lit


def _measure(tree: MinMaxTree, rays: SliceRays, ray: Tensor, node: Tensor, level: int) -> _Stretches:
    """The pairs whose ray spends any of its length in the node."""
    row = rays.slice_number[ray]
    low = rays.fraction_at(tree.edges[row, node << level], ray)
    high = rays.fraction_at(tree.edges[row, (node + 1) << level], ray)
    touched = low != high
    ray, node, low, high = ray[touched], node[touched], low[touched], high[touched]
    enter, leave = torch.minimum(low, high), torch.maximum(low, high)
    return _Stretches(ray, node, enter, leave, rays.depth_at(enter, ray), rays.depth_at(leave, ray))


def _cut_leaves(tree: MinMaxTree, rays: SliceRays, run: _Stretches) -> tuple[Tensor, Tensor, Tensor]:
    """Lit part of each run of one cell: all of it, none, or up to or from where the ray passes the cell's depth."""
    depth = tree.minimum[rays.slice_number[run.ray], tree.cells + run.node]
    enters_lit, leaves_lit = run.enter_depth <= depth, run.leave_depth <= depth
    start_depth = rays.start_depth[run.ray]
    slope = rays.end_depth[run.ray] - start_depth
    passes = enters_lit != leaves_lit
    crossing = (depth - start_depth) / torch.where(passes, slope, 1.0)
    crossing = torch.minimum(torch.maximum(crossing, run.enter), run.leave)
    start = torch.where(enters_lit, run.enter, crossing)
    end = torch.where(leaves_lit, run.leave, crossing)
    lit = (enters_lit | leaves_lit) & (end > start)
    return run.ray[lit], start[lit], end[lit]
