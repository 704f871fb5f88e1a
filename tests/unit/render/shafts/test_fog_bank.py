import math
from dataclasses import replace

import pytest
import torch

from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.fused import torch_loops_only
from render.random_streams import child_generator
from render.shafts.air import Air
from render.shafts.fog_bank import FogBank, build_shades, insert_bank_edges, look_up_shade
from render.shafts.frame import compose_frame
from render.shafts.lights import AlwaysLit, Lighting, Sun, SunInScene, build_sun_depth
from render.shafts.march import march
from render.shafts.methods import METHODS, Adaptive, BruteForce
from render.shafts.participating_media import SpheroidMedium
from render.shafts.rays import ViewRays, uniform_edges
from render.shafts.self_shadowing import DistantLight, NearLight
from render.shafts.stage import Stage
from tests.support.shaft_scenes import relative_rms, small_scene, small_stage

BLOCK = DensityGrid.from_voxel_size(torch.full((4, 6, 8), 0.5), 10.0, (0.0, 0.0, 0.0))
"""80 m by 60 m by 40 m of density 0.5."""
SPHEROID = SpheroidMedium(
    (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1, 10.0, radius_variation=0.0, flattening=1.0, noise_amplitude=0.0
)
FOG = FogBank(
    SpheroidMedium((0.0, -6.0, 4.0), (9.0, 6.0, 2.0), 14, 6.0, noise_wavelength=6.0, seed=3, wind=(2.0, 0.0, 0.0)),
    0.15,
    albedo=0.9,
    asymmetry=0.4,
    resolution=40,
)


def level_rays(*sideways: float) -> ViewRays:
    origin = torch.zeros(len(sideways), 3)
    origin[:, 0], origin[:, 1] = -20.0, torch.tensor(sideways)
    return ViewRays(origin, torch.tensor([[1.0, 0.0, 0.0]]).expand_as(origin), torch.full((len(sideways),), 40.0))


def uniform_ball(resolution: int, radius: float = 10.0) -> FogBank:
    """Density 1 within a sphere, each voxel holding the share of it that lies inside, by 4^3 points."""
    fine = (torch.arange(4 * resolution) + 0.5) / (2.0 * resolution) - 1.0
    z, y, x = torch.meshgrid(fine, fine, fine, indexing="ij")
    inside = (x * x + y * y + z * z <= 1.0).float()
    density = torch.nn.functional.avg_pool3d(inside[None], 4)[0]
    return FogBank(DensityGrid(density, torch.full((3,), -radius), torch.full((3,), radius)), 0.05)


def test_a_uniform_sphere_has_the_transmittance_of_its_chords() -> None:
    rays = level_rays(0.0, 3.0, 6.0, 8.0)
    chord = 2.0 * (100.0 - rays.origin[:, 1].square()).sqrt()
    wanted = torch.exp(-0.05 * chord)
    errors = []
    for resolution in (12, 24, 48):
        depth = Air(banks=(uniform_ball(resolution),)).compute_ray_depths(rays)[0]
        errors.append(float((torch.exp(-depth[:, 0]) - wanted).abs().max()))
    assert errors[2] < 2e-3
    assert errors[2] < 0.5 * errors[0]
    assert float((torch.exp(-0.05 * 0.98 * chord) - wanted).abs().max()) > 2e-3


def test_through_the_middle_of_a_spheroid_the_depth_is_that_of_its_radius() -> None:
    """The integral of p(1 - |x| / R) from -R to R is R."""
    depth = FogBank(SPHEROID, 0.02, (1.0, 2.0, 0.5), resolution=64).compute_ray_depth(level_rays(0.0))
    torch.testing.assert_close(depth, torch.tensor([[0.2, 0.4, 0.1]]), rtol=2e-3, atol=0.0)
    assert float(FogBank(SPHEROID, 0.02, strength=0.5).compute_ray_depth(level_rays(0.0))[0, 0]) == pytest.approx(
        0.1, rel=3e-3
    )


def lit_block(shadow: bool = True) -> tuple[Air, Lighting]:
    sun = Sun((0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    air = Air(banks=(FogBank(BLOCK, 0.03, albedo=0.7, shadow=shadow),))
    shades = build_shades(air.banks, DistantLight(sun.direction))
    return air, Lighting(SunInScene(sun, build_sun_depth(air, sun, 0.0, 50.0), AlwaysLit(), shades))


@pytest.mark.parametrize("torch_only", [False, True])
def test_a_block_under_the_zenith_sun_scatters_its_closed_form(torch_only: bool) -> None:
    """A level ray at depth h: albedo / (4 pi) exp(-sigma h) (1 - exp(-sigma 80 m)), with sigma = 0.03 / m times 0.5."""
    air, lighting = lit_block()
    origin = torch.tensor([[-10.0, 30.0, 33.0], [-10.0, 30.0, 7.0]])
    rays = ViewRays(origin, torch.tensor([[1.0, 0.0, 0.0]]).expand(2, 3), torch.full((2,), 100.0))
    edges = insert_bank_edges(rays, uniform_edges(rays, 1), air.banks, 64)
    if torch_only:
        with torch_loops_only():
            found = march(air, lighting, rays, edges)
    else:
        found = march(air, lighting, rays, edges)
    through = -math.expm1(-0.015 * 80.0)
    wanted = torch.tensor([0.7 / (4.0 * math.pi) * math.exp(-0.015 * h) * through for h in (7.0, 33.0)])
    torch.testing.assert_close(found.in_scattering[:, 0], wanted, rtol=2e-4, atol=0.0)
    torch.testing.assert_close(found.depth, torch.full((2, 3), 1.2), rtol=1e-4, atol=0.0)
    bare, unshaded = lit_block(shadow=False)
    assert unshaded.sun is not None
    assert unshaded.sun.shades == (None,)
    light = march(bare, unshaded, rays, edges).in_scattering[:, 0]
    torch.testing.assert_close(light, torch.full((2,), 0.7 / (4.0 * math.pi) * through), rtol=2e-4, atol=0.0)


def test_a_bank_dims_what_lies_behind_it() -> None:
    banks = (FogBank(BLOCK, 0.03, (1.0, 2.0, 0.0)),)
    points = torch.tensor([[[40.0, 30.0, -5.0], [40.0, 30.0, 50.0]]])
    above = look_up_shade(banks, build_shades(banks, NearLight((40.0, 30.0, 100.0))), points)
    torch.testing.assert_close(above, torch.tensor([[[0.6, 1.2, 0.0], [0.0, 0.0, 0.0]]]), rtol=1e-4, atol=1e-6)
    assert torch.equal(look_up_shade(banks, (), points), torch.zeros(1, 2, 3))
    clear = small_scene(meshes=small_scene().meshes, lamps=False)
    foggy = replace(clear, air=replace(clear.air, banks=(FOG,)))
    assert float((small_stage(foggy).background - small_stage(clear).background).max()) <= 1e-6
    assert float((small_stage(clear).background - small_stage(foggy).background).max()) > 0.005


def foggy_stage(width: int = 24, height: int = 16) -> Stage:
    scene = small_scene(width, height)
    return small_stage(replace(scene, air=replace(scene.air, banks=(FOG,))))


def test_light_converges_with_the_square_of_the_steps() -> None:
    stage = foggy_stage()
    stage = replace(stage, lighting=replace(stage.lighting, sun=replace(stage.lighting.sun, visibility=AlwaysLit())))
    light = [BruteForce(n).gather(stage).in_scattering for n in (64, 128, 256, 2048)]
    errors = [relative_rms(one, light[3]) for one in light[:3]]
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] < 0.5 * errors[1]
    assert errors[2] < 2e-3


def test_every_method_carries_banks() -> None:
    stage = foggy_stage()
    without = replace(stage, scene=replace(stage.scene, air=replace(stage.scene.air, banks=())))
    for name, method in METHODS.items():
        dense = method.at_full_density(256).gather(stage).in_scattering
        exact = BruteForce(256).gather(stage).in_scattering
        assert relative_rms(dense, exact) < {"chen2011": 5e-3, "biri2006": 5e-3, "tan2020_froxels": 1e-2}.get(
            name, 1e-4
        ), name
        assert relative_rms(method.gather(without).in_scattering, exact) > 0.05, name


def test_adaptive_steps_within_the_bank_pay() -> None:
    stage = foggy_stage(64, 40)
    truth = BruteForce(1024).gather(stage).in_scattering
    error = relative_rms(Adaptive().gather(stage).in_scattering, truth)
    assert error < 0.02
    assert relative_rms(Adaptive(bank_steps=0.0).gather(stage).in_scattering, truth) > 2.0 * error


def test_borders_are_inserted_where_the_bank_is() -> None:
    rays = ViewRays(
        torch.tensor([[-10.0, 30.0, 5.0], [-10.0, 90.0, 5.0]]),
        torch.tensor([[1.0, 0.0, 0.0]]).expand(2, 3),
        torch.tensor([50.0, 30.0]),
    )
    edges = insert_bank_edges(rays, uniform_edges(rays, 2), (FogBank(BLOCK, 1.0),), 4)
    torch.testing.assert_close(edges[0], torch.tensor([0.0, 10.0, 20.0, 25.0, 30.0, 40.0, 50.0, 50.0]))
    torch.testing.assert_close(edges[1], torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 15.0, 30.0]))
    assert torch.equal(insert_bank_edges(rays, edges, (), 4), edges)


def test_wind_carries_the_bank_through_the_scene() -> None:
    points = torch.randn(500, 3, generator=child_generator(5)) * 8.0 + torch.tensor([0.0, -6.0, 4.0])
    later = FOG.at_time(5.0)
    moved = later.grid.look_up_density(points + torch.tensor([10.0, 0.0, 0.0]))
    torch.testing.assert_close(moved, FOG.grid.look_up_density(points), rtol=0.0, atol=1e-3)
    assert not torch.allclose(later.grid.look_up_density(points), FOG.grid.look_up_density(points), atol=0.1)
    scene = foggy_stage().scene
    assert scene.at_time(5.0).air.banks[0].time == 5.0


def test_banks_that_cannot_be_are_refused() -> None:
    for wrong in ({"extinction": -1.0}, {"strength": math.inf}, {"resolution": 0}, {"time": math.nan}, {"albedo": 2.0}):
        with pytest.raises(ParameterError):
            replace(FOG, **wrong)
    with pytest.raises(ParameterError, match="fills no box"):
        FogBank(replace(SPHEROID, count=0), 0.1)
    assert FogBank(BLOCK, 0.0).empty
    assert not FOG.empty


@pytest.mark.parametrize(("extinction", "strength"), [(0.0, 1.0), (1e-12, 1.0), (0.2, 0.0), (0.2, 1.0), (1e5, 1.0)])
def test_from_within_a_bank_of_any_density_all_is_finite(extinction: float, strength: float) -> None:
    scene = small_scene()
    lamp = replace(scene.lights[0], position=(-1.0, -40.0, 6.0))
    around = replace(FOG.medium, middle=(0.0, -48.0, 6.0), wind=(0.0, 0.0, 0.0))
    bank = replace(FOG, medium=around, extinction=extinction, strength=strength)
    inside = replace(scene, lights=(lamp,), air=replace(scene.air, banks=(bank,)))
    frame = compose_frame(small_stage(inside), METHODS["auto"])
    clear = compose_frame(small_stage(replace(inside, air=scene.air)), METHODS["auto"])
    assert bool(torch.isfinite(frame.radiance).all())
    if bank.extinction * strength < 1e-9:
        torch.testing.assert_close(frame.radiance, clear.radiance, rtol=2e-2, atol=1e-3)
        torch.testing.assert_close(frame.transmittance, clear.transmittance, rtol=1e-5, atol=1e-7)
    else:
        assert float((frame.radiance - clear.radiance).abs().max()) > 0.02
    if extinction > 1e3:
        assert float(frame.transmittance.max()) < 1e-6
