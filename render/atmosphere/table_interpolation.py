"""Multilinear interpolation in tables whose last dimension is the wavelength."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

POINTS_AT_ONCE = 1 << 16
"""Points that are looked up together: sixteen corners of each, an index and a weight, take 16 MB."""


def interpolate_table(table: Tensor, indices: Sequence[Tensor]) -> Tensor:
    """Interpolate linearly along each axis; outside the nodes the table is held at its border.

    Args:
        table: `(axis_1, ..., axis_n, wavelength)`.
        indices: place on each axis in nodes, 0 for the first, fractions between; n tensors that broadcast to `(...)`. Gradients flow
            through them and through the table.

    Returns:
        Values `(..., wavelength)` of the table's type.
    """
    places = torch.broadcast_tensors(*indices)
    shape = places[0].shape
    flat = [place.reshape(-1) for place in places]
    rows = table.reshape(-1, table.shape[-1])
    found = [
        _interpolate_points(rows, table.shape[:-1], [place[start : start + POINTS_AT_ONCE] for place in flat])
        for start in range(0, max(len(flat[0]), 1), POINTS_AT_ONCE)
    ]
    return torch.cat(found).reshape(*shape, table.shape[-1])


def nearest_nodes(place: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The node below each place and the weight of the node above.

    Args:
        place: in nodes `(...)`; held at the first and the last.
        count: nodes of the axis, at least 2.

    Returns:
        Lower node, 0..count - 2 `(...)`, int64, and the weight of the next one, 0..1 `(...)`.
    """
    held = place.clamp(0.0, count - 1.0)
    lower = held.detach().floor().clamp(max=count - 2.0)
    return lower.to(torch.int64), held - lower


def _interpolate_points(rows: Tensor, sizes: Sequence[int], places: Sequence[Tensor]) -> Tensor:
    """Values `(point, wavelength)` at points given by one tensor `(point,)` per axis."""
    index = places[0].new_zeros(len(places[0]), 1, dtype=torch.int64)
    weight = places[0].new_ones(len(places[0]), 1)
    for size, place in zip(sizes, places, strict=True):
        lower, above = nearest_nodes(place, size)
        corners = lower[:, None] + torch.arange(2, device=lower.device)
        index = (index[:, :, None] * size + corners[:, None, :]).flatten(1)
        weight = (weight[:, :, None] * torch.stack([1.0 - above, above], -1)[:, None, :]).flatten(1)
    return embedding_bag(index, rows, per_sample_weights=weight.to(rows.dtype), mode="sum")
