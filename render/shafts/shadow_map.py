"""Shadows of the sun: for each line towards the sun, how far along it the last surface lies.

With (across, up, towards the sun) as axes, a point lies in shadow if the topmost surface in its column is nearer to the sun than the
point is. The map holds that height for the middles of square texels. They cover those casters whose columns the view rays pass; beyond
them nobody asks, or everything is lit.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.camera import Vector
from render.errors import ParameterError
from render.shafts.ray_casting import RayCaster

ROWS_AT_ONCE = 256
"""Rows of the map whose rays are cast at once."""


@dataclass(frozen=True, eq=False)
class ShadowMap:
    """Topmost surfaces as seen from the sun.

    Args:
        axes: unit vectors across, up and towards the sun `(3, 3)`, one a row.
        lower: corner of the map along the first two axes `(2,)` [m].
        texel: side of a texel [m].
        tops: place of the topmost surface along the third axis `(up, across)` [m]; minus infinity where there is none.
    """

    axes: Tensor
    lower: Tensor
    texel: float
    tops: Tensor

    def look_up_lit(self, points: Tensor) -> Tensor:
        """Whether the sun reaches points `(..., 3)` [m]: booleans `(...)`, by the nearest texel."""
        place = points @ self.axes.to(points).T
        cell = ((place[..., :2] - self.lower.to(points)) / self.texel).floor()
        rows, columns = self.tops.shape
        column, row = cell[..., 0], cell[..., 1]
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        index = row.clamp(0, rows - 1).long() * columns + column.clamp(0, columns - 1).long()
        top = self.tops.reshape(-1)[index]
        return ~(inside & (place[..., 2] < top))


def build_shadow_map(caster: RayCaster, direction: Vector, resolution: int, region: Tensor | None = None) -> ShadowMap:
    """Cast a ray from the sun through every texel.

    Args:
        caster: what throws shadows.
        direction: unit vector towards the sun.
        resolution: texels along the longer side, at least 1.
        region: points `(point, 3)` [m] whose convex hull holds whatever will be looked up; None for everywhere.

    Returns:
        The map.

    Raises:
        ParameterError: for a resolution below 1.
    """
    if resolution < 1:
        raise ParameterError(f"expected a shadow map of at least one texel, got a resolution of {resolution}")
    axes = light_axes(direction)
    if caster.lower is None or caster.upper is None:
        return _empty_map(axes)
    box = torch.cartesian_prod(*torch.stack([caster.lower, caster.upper], 1).double()) @ axes.T
    lower, upper = box.amin(0)[:2], box.amax(0)[:2]
    if region is not None:
        seen = region.double() @ axes[:2].T
        lower, upper = torch.maximum(lower, seen.amin(0)), torch.minimum(upper, seen.amax(0))
    extent = (upper - lower).tolist()
    if min(extent) < 0.0 or max(extent) == 0.0:
        return _empty_map(axes)
    texel = max(extent) / resolution
    columns, rows = (max(1, math.ceil(side / texel)) for side in extent)
    highest, lowest = float(box[:, 2].max()), float(box[:, 2].min())
    start = torch.tensor(highest + 0.01 * (highest - lowest) + texel, dtype=torch.float64)
    across = lower[0] + (torch.arange(columns, dtype=torch.float64) + 0.5) * texel
    parts = []
    for first in range(0, rows, ROWS_AT_ONCE):
        up = lower[1] + (torch.arange(first, min(first + ROWS_AT_ONCE, rows), dtype=torch.float64) + 0.5) * texel
        v, u = torch.meshgrid(up, across, indexing="ij")
        origin = torch.stack([u, v, start.expand_as(u)], dim=-1).reshape(-1, 3) @ axes
        fallen = caster.find_distance(origin, -axes[2].expand_as(origin))
        parts.append((start - fallen.double()).float().reshape(len(up), columns))
    return ShadowMap(axes.float(), lower.float(), texel, torch.cat(parts).contiguous())


def _empty_map(axes: Tensor) -> ShadowMap:
    """A map in which everything is lit."""
    return ShadowMap(axes.float(), torch.zeros(2), 1.0, torch.full((1, 1), -math.inf))


def light_axes(direction: Vector) -> Tensor:
    """Right-handed unit vectors `(3, 3)`, float64: across, up, towards the light."""
    towards = torch.tensor(direction, dtype=torch.float64)
    upright = torch.tensor([0.0, 0.0, 1.0] if abs(direction[2]) < 0.99 else [0.0, 1.0, 0.0], dtype=torch.float64)
    across = torch.nn.functional.normalize(torch.linalg.cross(upright, towards), dim=0)
    return torch.stack([across, torch.linalg.cross(towards, across), towards])
