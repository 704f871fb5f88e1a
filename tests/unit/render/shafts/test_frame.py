import math
from dataclasses import replace

import pytest
import torch

from render.media import Uniform
from render.shafts.air import Air, Constituent
from render.shafts.casters import make_box, make_ground, make_height_field
from render.shafts.frame import Frame, compose_frame, render_frame
from render.shafts.lights import PointLight
from render.shafts.mesh import make_mesh
from render.shafts.methods import METHODS, BruteForce, Froxels
from render.shafts.scene import ShaftScene
from render.shafts.stage import MapSettings
from tests.support.shaft_scenes import FOG, SMALL_MAPS, small_scene, small_stage


def check(frame: Frame) -> None:
    for layer in frame.layers().values():
        assert torch.isfinite(layer).all()
        assert (layer >= 0.0).all()
    assert (frame.transmittance <= 1.0).all()


def test_the_picture_is_the_sum_of_its_parts() -> None:
    frame = render_frame(replace(small_scene(), ambient=(0.1, 0.2, 0.3)), BruteForce(16), SMALL_MAPS)
    check(frame)
    whole = frame.transmittance * frame.background + frame.in_scattering + frame.ambient
    torch.testing.assert_close(frame.radiance, whole)
    assert frame.radiance.shape == (16, 24, 3)
    assert set(frame.seconds) >= {"depth buffer", "shadow maps", "gathering light", "composition"}
    assert frame.modelled


def test_ambient_light_fills_the_air_by_what_it_extinguishes() -> None:
    scene = replace(small_scene(air=Air((FOG,))), ambient=(0.1, 0.2, 0.3))
    frame = render_frame(scene, BruteForce(4), SMALL_MAPS)
    wanted = 0.9 * (1.0 - frame.transmittance) * torch.tensor([0.1, 0.2, 0.3])
    torch.testing.assert_close(frame.ambient, wanted, rtol=1e-4, atol=1e-6)


def test_zero_density_shows_the_background() -> None:
    for air in (Air(), Air((Constituent(Uniform(0.0, 50.0)),))):
        frame = render_frame(small_scene(air=air), BruteForce(8), SMALL_MAPS)
        assert torch.equal(frame.radiance, frame.background)


def test_density_so_thick_that_nothing_is_seen() -> None:
    thick = Air((Constituent(Uniform(50.0, 60.0, -math.inf), albedo=0.9),))
    for method in METHODS.values():
        frame = render_frame(replace(small_scene(air=thick), ambient=(1.0, 1.0, 1.0)), method, SMALL_MAPS)
        check(frame)
        assert float(frame.transmittance.max()) == 0.0
        torch.testing.assert_close(frame.ambient, torch.full_like(frame.ambient, 0.9))


VIEWS = {
    "sun in frame": ((0.0, -50.0, 6.0), (13.0, 0.0, 30.0)),
    "sun at the border": ((0.0, -50.0, 6.0), (13.0, 0.0, 12.0)),
    "sun behind": ((0.0, 50.0, 6.0), (0.0, 0.0, 8.0)),
    "straight up": ((0.0, -50.0, 6.0), (0.0, -50.0, 60.0)),
    "straight down": ((0.0, -50.0, 40.0), (0.0, -50.0, 0.0)),
}


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("view", VIEWS)
def test_every_method_renders_every_view(name: str, view: str) -> None:
    scene = small_scene()
    position, target = VIEWS[view]
    stage = small_stage(replace(scene, camera=replace(scene.camera, position=position, target=target)))
    check(compose_frame(stage, METHODS[name]))


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("elevation_deg", [0.0, 0.5, -3.0, 90.0])
def test_the_sun_at_the_horizon_below_it_and_overhead(name: str, elevation_deg: float) -> None:
    frame = compose_frame(small_stage(small_scene(sun_elevation_deg=elevation_deg, lamps=False)), METHODS[name])
    check(frame)
    assert (float(frame.in_scattering.max()) > 0.0) is (elevation_deg >= 0.0)


@pytest.mark.parametrize("name", METHODS)
def test_an_empty_scene_and_one_without_light(name: str) -> None:
    scene = small_scene(meshes=())
    check(compose_frame(small_stage(scene), METHODS[name]))
    dark = compose_frame(small_stage(replace(scene, sun=None, lights=())), METHODS[name])
    assert torch.equal(dark.radiance, torch.zeros_like(dark.radiance))


@pytest.mark.parametrize("name", METHODS)
def test_a_light_inside_a_mesh_lights_nothing_outside(name: str) -> None:
    lamp = PointLight((2.0, 0.0, 9.0), (500.0, 500.0, 500.0))
    frame = compose_frame(
        small_stage(replace(small_scene(), sun=None, lights=(lamp,), sky=(0.0, 0.0, 0.0))), METHODS[name]
    )
    check(frame)
    outside = compose_frame(
        small_stage(
            replace(small_scene(), sun=None, lights=(replace(lamp, position=(12.0, 0.0, 9.0)),), sky=(0.0, 0.0, 0.0))
        ),
        METHODS[name],
    )
    # The cell of a froxel column that holds a surface lies on both of its sides; finer cells let less through.
    leak = 0.1 if name == "tan2020_froxels" else 1e-3
    assert float(frame.in_scattering.mean()) < leak * float(outside.in_scattering.mean())


def test_what_leaks_through_surfaces_in_froxels_shrinks_with_the_cells() -> None:
    lamp = PointLight((2.0, 0.0, 9.0), (500.0, 500.0, 500.0))
    stage = small_stage(replace(small_scene(), sun=None, lights=(lamp,)))
    leaks = [float(Froxels(n, 1, 1.0).gather(stage).in_scattering.mean()) for n in (32, 128, 512)]
    assert 0.0 < leaks[2] < 0.5 * leaks[1] < 0.25 * leaks[0]


def test_a_camera_inside_a_box_of_fog_sees_no_sun() -> None:
    box = make_box((-5.0, -55.0, 1.0), (5.0, -45.0, 11.0))
    frame = compose_frame(small_stage(small_scene(meshes=(box,), lamps=False), MapSettings(exact=True)), BruteForce(64))
    assert float(frame.in_scattering.max()) == 0.0
    opened = make_box((-5.0, -55.0, 1.0), (5.0, -45.0, 3.0))
    assert (
        float(compose_frame(small_stage(small_scene(meshes=(opened,), lamps=False)), BruteForce(8)).in_scattering.max())
        > 0.0
    )


def test_a_mesh_with_holes_and_degenerate_triangles() -> None:
    torn = make_height_field(torch.rand(12, 12, generator=torch.Generator().manual_seed(1)) * 6.0, (-20.0, -20.0), 4.0)
    kept = torch.arange(len(torn.triangles)) % 5 != 0
    flat = torch.tensor([[0, 0, 1], [3, 3, 3]])
    mesh = make_mesh(torn.vertices, torch.cat([torn.triangles[kept], flat]))
    scene: ShaftScene = small_scene(meshes=(mesh, make_ground(300.0, -1.0)))
    check(render_frame(scene, METHODS["adaptive"], SMALL_MAPS))
