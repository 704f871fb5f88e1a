import math
from contextlib import nullcontext

import pytest
import torch

from render.camera import direction_from_angles
from render.errors import ParameterError
from render.fused import torch_loops_only
from render.media import ExponentialDecay, LinearDecay, Uniform, compute_in_scattering
from render.shafts.air import Air, Constituent
from render.shafts.casters import make_sphere
from render.shafts.cube_shadow_map import CubeShadowMap, build_cube_shadow_map, face_directions
from render.shafts.lamp_steps import edges_towards_lamp
from render.shafts.lights import AlwaysLit, Lighting, PointInScene, PointLight, Sun, SunInScene, build_sun_depth
from render.shafts.march import ShadowLooks, accumulate_sunlight, march
from render.shafts.ray_casting import RayCaster, SunRays
from render.shafts.rays import ViewRays, uniform_edges

SUN = Sun(direction_from_angles(0.4, math.radians(32.0)), (2.0, 1.5, 1.0))


def random_rays(count: int = 40, double: bool = True) -> ViewRays:
    generator = torch.Generator().manual_seed(2)
    origin = torch.rand(count, 3, generator=generator) * 30.0
    direction = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
    rays = ViewRays(origin, direction, torch.rand(count, generator=generator) * 200.0)
    return rays.doubled() if double else rays


def lit_by_sun(air: Air, sun: Sun = SUN) -> Lighting:
    return Lighting(SunInScene(sun, build_sun_depth(air, sun, -250.0, 250.0), AlwaysLit()))


@pytest.mark.parametrize(
    "medium", [Uniform(0.01, 70.0, -300.0), LinearDecay(0.02, 90.0, -300.0), ExponentialDecay(0.01, 40.0, -math.inf)]
)
@pytest.mark.parametrize("steps", [1, 7])
def test_fog_without_occluders_is_the_closed_form_with_any_number_of_steps(medium: Uniform, steps: int) -> None:
    part = Constituent(medium, albedo=0.8, asymmetry=0.3)
    rays = random_rays()
    marched = march(Air((part,)), lit_by_sun(Air((part,))), rays, uniform_edges(rays, steps))
    sun = torch.tensor(SUN.direction, dtype=torch.float64)
    gathered = compute_in_scattering(medium, rays.origin[:, 2], rays.direction[:, 2], sun[2], rays.distance)
    scale = 0.8 * part.evaluate_phase(rays.direction @ sun) * gathered
    wanted = scale[:, None] * torch.tensor(SUN.irradiance, dtype=torch.float64)
    torch.testing.assert_close(marched.in_scattering, wanted, rtol=2e-3, atol=1e-5)
    half = march(Air((part,)), lit_by_sun(Air((part,))), rays, 0.5 * uniform_edges(rays, steps)).in_scattering
    assert not torch.allclose(half, wanted, rtol=2e-2)


def test_two_constituents_converge_with_the_square_of_the_steps() -> None:
    air = Air(
        (
            Constituent(Uniform(0.01, 70.0, -300.0), asymmetry=0.6),
            Constituent(ExponentialDecay(0.02, 30.0, -math.inf), (0.3, 0.6, 1.0), phase="rayleigh"),
        )
    )
    rays = random_rays()
    light = [march(air, lit_by_sun(air), rays, uniform_edges(rays, n)).in_scattering for n in (8, 32, 1024)]
    errors = [float((part - light[2]).abs().max()) for part in light[:2]]
    assert errors[1] < 0.2 * errors[0]
    assert errors[1] < 2e-3 * float(light[2].max())


def test_the_accumulated_light_ends_with_that_of_the_march() -> None:
    air = Air((Constituent(Uniform(0.01, 70.0, -300.0), asymmetry=0.6),))
    rays, lighting = random_rays(), lit_by_sun(air)
    edges = uniform_edges(rays, 9)
    assert lighting.sun is not None
    table = accumulate_sunlight(air, lighting.sun, rays, edges)
    torch.testing.assert_close(table[:, -1], march(air, lighting, rays, edges).in_scattering)
    assert torch.equal(table[:, 0], torch.zeros(len(rays), 3, dtype=torch.float64))
    assert (table.diff(dim=1) >= 0.0).all()


def test_a_sphere_in_uniform_fog_leaves_the_analytic_lit_intervals() -> None:
    centre, radius, sigma = torch.tensor([0.0, 0.0, 20.0], dtype=torch.float64), 5.0, 0.01
    part = Constituent(Uniform(sigma, 1000.0, -1000.0), asymmetry=0.2)
    air = Air((part,))
    down = Sun((0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    rays = random_rays()
    rays = ViewRays(rays.origin - torch.tensor([15.0, 15.0, 30.0], dtype=torch.float64), rays.direction, rays.distance)
    caster = RayCaster((make_sphere((0.0, 0.0, 20.0), radius, 400),))
    lighting = Lighting(SunInScene(down, build_sun_depth(air, down, -400.0, 400.0), SunRays(caster, down.direction)))
    found = march(air, lighting, rays, uniform_edges(rays, 100), looks=ShadowLooks(4, 12)).in_scattering[:, 0]
    table = march(air, lit_by_sun(air, down), rays, uniform_edges(rays, 1)).in_scattering[:, 0]
    lost = torch.stack([_shadow_of_sphere(part, rays[n : n + 1], centre, radius) for n in range(len(rays))])
    assert float((found - (table - lost)).abs().max()) < 1e-3 * float(table.max())
    assert float(lost.max()) > 0.05 * float(table.max())
    assert float((found - (table - 0.9 * lost)).abs().max()) > 1e-3 * float(table.max())


def _shadow_of_sphere(part: Constituent, ray: ViewRays, centre: torch.Tensor, radius: float) -> torch.Tensor:
    """Light that a ray would gather in the shadow of a sphere under the zenith sun: the ball, and the cylinder below it."""
    along = torch.linspace(0.0, 1.0, 200_001, dtype=torch.float64) * ray.distance
    points = ray.origin + along[:, None] * ray.direction
    offset = points - centre
    flat = offset[:, :2].square().sum(1)
    dark = (flat < radius**2) & (offset[:, 2] < (radius**2 - flat).clamp(min=0.0).sqrt())
    sigma = 0.01
    light = sigma * torch.exp(-sigma * (along + 1000.0 - points[:, 2])) * part.evaluate_phase(ray.direction[0, 2:])
    return torch.trapezoid(torch.where(dark, light, 0.0), along)


def test_a_lamp_in_empty_fog_is_the_integral_along_the_ray() -> None:
    sigma = 0.02
    part = Constituent(Uniform(sigma, 1e4, -1e4), albedo=0.7, asymmetry=0.4)
    lamp = PointLight((10.0, 12.0, 9.0), (5.0, 4.0, 3.0), radius=0.3, reach=80.0)
    rays = random_rays(12)
    lighting = Lighting(points=(PointInScene(lamp, AlwaysLit()),))
    found = march(Air((part,)), lighting, rays, uniform_edges(rays, 400)).in_scattering
    t = torch.linspace(0.0, 1.0, 400_001, dtype=torch.float64)[None] * rays.distance[:, None]
    offset = torch.tensor(lamp.position, dtype=torch.float64) - rays.points_at(t)
    distance = torch.linalg.vector_norm(offset, dim=-1)
    cosine = (offset * rays.direction[:, None]).sum(-1) / distance
    density = (
        sigma
        * torch.exp(-sigma * (t + distance))
        * part.evaluate_phase(cosine)
        * lamp.window(distance)
        / (distance**2 + 0.09)
    )
    wanted = 0.7 * torch.trapezoid(density, t, dim=1)[:, None] * torch.tensor(lamp.intensity, dtype=torch.float64)
    torch.testing.assert_close(found, wanted, rtol=2e-3, atol=1e-7)
    assert not torch.allclose(found, 0.99 * wanted, rtol=2e-3, atol=1e-7)


@pytest.mark.parametrize("torch_only", [False, True])
def test_few_steps_of_equal_angles_find_the_light_next_to_a_lamp(torch_only: bool) -> None:
    """Equal steps of the same number miss it: the light turns from forward to backward within one of them."""
    air = Air((Constituent(Uniform(0.05, 1e4, -1e4), asymmetry=0.6),))
    lamp = PointLight((0.0, 20.0, 0.0), (1.0, 1.0, 1.0))
    lighting = Lighting(points=(PointInScene(lamp, AlwaysLit()),))
    aside = torch.logspace(-3.0, 0.7, 24)
    direction = torch.nn.functional.normalize(torch.stack([aside, torch.full_like(aside, 20.0), 0.0 * aside], 1), dim=1)
    rays = ViewRays(torch.zeros(24, 3), direction, torch.full((24,), 60.0))

    def gather(edges: torch.Tensor) -> torch.Tensor:
        return march(air, lighting, rays, edges).in_scattering[:, 0]

    with torch_loops_only() if torch_only else nullcontext():
        wanted = gather(edges_towards_lamp(rays, lamp.position, lamp.radius, 400))
        error = (gather(edges_towards_lamp(rays, lamp.position, lamp.radius, 12)) / wanted - 1.0).abs()
        equal = (gather(uniform_edges(rays, 12)) / wanted - 1.0).abs()
    assert float(error.max()) < 0.03
    assert float(equal.max()) > 0.2


@pytest.mark.parametrize("torch_only", [False, True])
def test_the_lit_share_of_a_lamp_is_that_of_the_angle(torch_only: bool) -> None:
    """A wall cuts the ray where the angle at the lamp is a third of the whole, far from a third of the length."""
    lamp = PointLight((0.0, 0.0, 1.0), (1.0, 1.0, 1.0), radius=1e-3)
    rays = ViewRays(torch.tensor([[0.0, 0.0, 0.0]]), torch.tensor([[1.0, 0.0, 0.0]]), torch.tensor([20.0]))
    whole = math.atan(20.0)
    border = math.tan(whole / 3.0)
    air = Air((Constituent(Uniform(1e-6, 1e4, -1e4)),))
    edge = torch.tensor([border, 0.0, 0.0]) - torch.tensor(lamp.position)
    cube = build_cube_shadow_map(RayCaster(()), lamp.position, 512)
    directions = face_directions(512)
    dark = directions[..., 0] * -edge[2] > -directions[..., 2] * edge[0]
    cube = CubeShadowMap(cube.position, torch.where(dark, 0.0, math.inf).float())
    edges = torch.tensor([[0.0, 20.0]])
    with torch_loops_only() if torch_only else nullcontext():
        lit, shadowed = (
            march(
                air, Lighting(points=(PointInScene(lamp, seen),)), rays, edges, looks=ShadowLooks(4, 10)
            ).in_scattering
            for seen in (AlwaysLit(), cube)
        )
    share = float(shadowed[0, 0] / lit[0, 0])
    assert share == pytest.approx(1.0 / 3.0, abs=0.005)
    assert abs(border / 20.0 - 1.0 / 3.0) > 0.2


def test_nothing_that_scatters_gives_no_light() -> None:
    rays = random_rays(double=False)
    assert torch.equal(
        march(Air(), lit_by_sun(Air()), rays, uniform_edges(rays, 3)).in_scattering, torch.zeros(len(rays), 3)
    )
    fog = Air((Constituent(Uniform(0.1, 10.0)),))
    assert torch.equal(march(fog, Lighting(), rays, uniform_edges(rays, 3)).in_scattering, torch.zeros(len(rays), 3))


@pytest.mark.parametrize("torch_only", [False, True])
def test_fog_so_thick_that_nothing_is_seen_stays_finite(torch_only: bool) -> None:
    thick = Air((Constituent(Uniform(1e4, 100.0, -1e3)),))
    rays = random_rays(double=False)
    lamp = PointInScene(PointLight((5.0, 5.0, 5.0), (1.0, 1.0, 1.0)), AlwaysLit())
    lighting = Lighting(lit_by_sun(thick).sun, (lamp,))
    if torch_only:
        with torch_loops_only():
            light = march(thick, lighting, rays, uniform_edges(rays, 16))
    else:
        light = march(thick, lighting, rays, uniform_edges(rays, 16))
    assert torch.isfinite(light.in_scattering).all()
    assert float(light.in_scattering.max()) < 1e-6
    assert (torch.exp(-light.depth[rays.distance > 1.0]) == 0.0).all()


def test_looks_without_meaning_are_refused() -> None:
    for count, halvings in ((0, 0), (1, -1)):
        with pytest.raises(ParameterError):
            ShadowLooks(count, halvings)
