"""Sunlight of rays from their lit stretches, which a min-max tree finds for all rays of an epipolar slice at once."""

import torch
from torch import Tensor

from render.camera import PinholeCamera
from render.shafts.air import Air
from render.shafts.lights import Lighting, SunInScene
from render.shafts.march import accumulate_sunlight
from render.shafts.rays import ViewRays, uniform_edges
from render.shafts.shadow_map import ShadowMap
from render.shafts.slices import find_headings, find_lit_parts
from render.shafts.stage import Stage

RAYS_AT_ONCE = 1 << 13
"""Rays whose tables of light are kept at once."""


def sun_map(stage: Stage, lighting: Lighting) -> ShadowMap | None:
    """The sun's map if slices serve: the light is the sun, its shadows come from a map, and all rays begin at one eye."""
    if lighting.sun is None or not isinstance(stage.scene.camera, PinholeCamera):
        return None
    seen = lighting.sun.visibility
    return seen if isinstance(seen, ShadowMap) else None


def gather_lit_parts(
    air: Air, sun: SunInScene, seen: ShadowMap, rays: ViewRays, slice_number: Tensor, nodes: int
) -> Tensor:
    """Sunlight of rays, the shadows resolved to the texel whatever the number of nodes.

    Args:
        air: what scatters.
        sun: the light.
        seen: its map.
        rays: all from one eye.
        slice_number: number of the slice of each ray `(ray,)`; rays of one number lie in one plane with the sun.
        nodes: places along each ray between which the gathered light is interpolated, beside the first.

    Returns:
        Light `(ray, channel)`.
    """
    if not len(rays):
        return rays.origin.new_zeros(0, 3)
    number, slice_of_ray = torch.unique(slice_number, return_inverse=True)
    headings = find_headings(seen, rays.direction)
    # The ray that is seen farthest from the sun tells the heading best.
    flat = torch.linalg.vector_norm(rays.direction.double() @ seen.axes[:2].double().T, dim=1)
    widest = flat.new_zeros(len(number)).scatter_reduce_(0, slice_of_ray, flat, "amax", include_self=False)
    chosen = torch.zeros(len(number), dtype=torch.int64)
    is_widest = torch.nonzero(flat == widest[slice_of_ray])[:, 0]
    chosen[slice_of_ray[is_widest]] = is_widest
    share = torch.arange(nodes + 1, dtype=torch.float64) / nodes
    parts = []
    for first in range(0, len(rays), RAYS_AT_ONCE):
        some = slice(first, first + RAYS_AT_ONCE)
        gathered = accumulate_sunlight(air, sun, rays[some], uniform_edges(rays[some], nodes))
        lit = find_lit_parts(seen, headings[chosen], rays[some], slice_of_ray[some])
        parts.append(lit.integrate(share, gathered))
    return torch.cat(parts)
