import math

import torch

from render.camera import direction_from_angles
from render.shafts.casters import make_columns, make_sphere
from render.shafts.ray_casting import RayCaster
from render.shafts.rays import ViewRays
from render.shafts.shadow_map import build_shadow_map
from render.shafts.slices import find_headings, find_lit_parts

SUN = direction_from_angles(math.radians(20.0), math.radians(40.0))
MAP = build_shadow_map(RayCaster((make_columns(4, 4.0, 0.7, 6.0), make_sphere((0.0, 6.0, 5.0), 2.0))), SUN, 160)


def rays_from_one_eye(count: int) -> ViewRays:
    generator = torch.Generator().manual_seed(4)
    direction = torch.nn.functional.normalize(
        torch.randn(count, 3, generator=generator) * torch.tensor([0.5, 0.2, 0.2]) + torch.tensor([0.0, 1.0, 0.0]),
        dim=1,
    )
    return ViewRays(
        torch.tensor([0.3, -12.0, 3.0]).expand(count, 3), direction, torch.rand(count, generator=generator) * 40.0
    )


def test_lit_parts_are_those_of_the_map_place_by_place() -> None:
    rays = rays_from_one_eye(200)
    headings = find_headings(MAP, rays.direction)
    own = torch.arange(200)
    lit = find_lit_parts(MAP, headings, rays, own)
    share = (torch.arange(1000, dtype=torch.float64) + 0.5) / 1000
    looked_up = MAP.look_up_lit(rays.doubled().points_at(share * rays.doubled().distance[:, None]))
    assert (lit.contains(share) != looked_up).float().mean() < 1e-3
    assert 0.02 < float((~looked_up).float().mean()) < 0.9
    wrong = find_lit_parts(MAP, headings, rays, own.roll(1))
    assert (wrong.contains(share) != looked_up).float().mean() > 1e-2


def test_a_ray_along_the_light_has_a_heading() -> None:
    heading = find_headings(MAP, torch.tensor([SUN]))
    assert torch.isfinite(heading).all()
    below = torch.tensor([[0.0, 6.0, 5.0]]) - 6.0 * torch.tensor([SUN])
    up = ViewRays(below, torch.tensor([SUN]), torch.tensor([30.0]))
    lit = find_lit_parts(MAP, heading, up, torch.tensor([0]))
    # From 6 m before the middle of a sphere of 2 m to 30 m: dark up to its far side.
    assert abs(float(lit.lit_fraction()[0]) - 22.0 / 30.0) < 0.01
