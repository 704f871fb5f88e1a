"""View rays over the sun's shadow map: epipolar slices, planes that hold the eye and the sun.

Seen from the sun, all rays of a slice run along one half-line from the eye. Their depth is the place along the sun's axis, counted
away from the sun; places are counted in texels from the eye. `render.shafts.map_slices` finds what is lit.
"""

import torch
from torch import Tensor

from render.shafts.lit_intervals import LitIntervals
from render.shafts.map_slices import MapSlices, find_lit_in_map
from render.shafts.minmax_tree import SliceRays
from render.shafts.rays import ViewRays
from render.shafts.shadow_map import ShadowMap


def find_headings(shadow_map: ShadowMap, directions: Tensor) -> Tensor:
    """Unit vectors over the map `(ray, 2)`, float64, of ray directions `(ray, 3)`; any for a ray along the light."""
    flat = directions.double() @ shadow_map.axes[:2].double().T
    length = torch.linalg.vector_norm(flat, dim=1, keepdim=True)
    return torch.where(length > 0.0, flat / torch.where(length > 0.0, length, 1.0), flat.new_tensor([1.0, 0.0]))


def find_lit_parts(shadow_map: ShadowMap, heading: Tensor, rays: ViewRays, slice_number: Tensor) -> LitIntervals:
    """Lit stretches of rays.

    Args:
        shadow_map: of the sun.
        heading: unit vectors over the map `(slice, 2)`, float64.
        rays: all from one eye, at least one.
        slice_number: slice of each ray `(ray,)`; the ray is taken as lying in it.

    Returns:
        The stretches, as fractions of the rays.
    """
    axes = shadow_map.axes.double()
    eye = rays.origin[0].double() @ axes.T
    start = (eye[:2] - shadow_map.lower.double()) / shadow_map.texel
    offset = rays.distance.double()[:, None] * (rays.direction.double() @ axes.T)
    along = ((offset[:, :2] * heading[slice_number]).sum(1) / shadow_map.texel).clamp(min=0.0)
    first = -eye[2].expand_as(along)
    segments = SliceRays(slice_number, torch.zeros_like(along), along, first, first - offset[:, 2])
    return find_lit_in_map(MapSlices(-shadow_map.tops, start, heading), segments)
