import math
from dataclasses import replace

import pytest
import torch

from render.errors import ParameterError
from render.shafts.air import Air
from render.shafts.lights import AlwaysLit
from render.shafts.methods import BruteForce
from render.shafts.ray_casting import SunRays
from render.shafts.stage import Clock, MapSettings, prepare_stage, relight
from tests.support.shaft_scenes import small_scene, small_stage


def test_the_depth_buffer_ends_at_surfaces_or_at_the_reach() -> None:
    stage = small_stage()
    depth = stage.depth_buffer
    assert depth.shape == (16, 24)
    assert float(depth[0, 0]) == 160.0
    # The sphere in the middle of the image: 50 m away, 5 m thick.
    assert 44.0 < float(depth[7:10, 12:14].min()) < 47.0
    assert float(depth[-1].max()) < 60.0


def test_surfaces_are_lit_diffusely_and_shadows_are_dark() -> None:
    stage = small_stage(small_scene(meshes=None, air=Air(), lamps=False))
    ground = stage.background.unflatten(0, (16, 24))[-1]
    sun = stage.scene.sun
    assert sun is not None
    albedo = torch.tensor([0.10, 0.13, 0.05])
    wanted = albedo / math.pi * torch.tensor(sun.irradiance) * sun.direction[2]
    torch.testing.assert_close(ground[0], wanted, rtol=1e-3, atol=0.0)
    dark = small_stage(replace(stage.scene, sun=replace(sun, irradiance=(0.0, 0.0, 0.0)), sky=(0.0, 0.0, 0.0)))
    assert torch.equal(dark.background, torch.zeros_like(dark.background))


def test_ambient_light_and_lamps_light_surfaces() -> None:
    scene = replace(small_scene(), sun=None, lights=(), ambient=(1.0, 1.0, 1.0), sky=(0.0, 0.0, 0.0))
    ground = small_stage(scene).background.unflatten(0, (16, 24))[-1, 0]
    torch.testing.assert_close(ground, torch.tensor([0.10, 0.13, 0.05]), rtol=1e-5, atol=0.0)
    lamp = small_stage(replace(small_scene(), sun=None, ambient=(0.0, 0.0, 0.0))).background
    assert float(lamp.max()) > 0.0


def test_exact_shadows_take_the_place_of_maps() -> None:
    stage = small_stage()
    exact = relight(stage, MapSettings(exact=True))
    assert exact.lighting.sun is not None
    assert isinstance(exact.lighting.sun.visibility, SunRays)
    empty = small_stage(small_scene(meshes=()))
    assert empty.lighting.sun is not None
    assert isinstance(empty.lighting.sun.visibility, AlwaysLit)


def test_lights_that_do_not_shine_are_left_out() -> None:
    scene = small_scene()
    assert scene.sun is not None
    dark = replace(scene.sun, irradiance=(0.0, 0.0, 0.0)), (replace(scene.lights[0], intensity=(0.0, 0.0, 0.0)),)
    lighting = prepare_stage(replace(scene, sun=dark[0], lights=dark[1])).lighting
    assert lighting.sun is None
    assert not lighting.points


def test_rays_through_pixel_centres_are_those_of_the_pixels() -> None:
    stage = small_stage()
    rays = stage.rays_through(torch.tensor([[3.5, 2.5]]), torch.tensor([7.0]))
    torch.testing.assert_close(rays.direction[0], stage.rays.direction[2 * 24 + 3])
    assert rays.distance.tolist() == [7.0]


def test_settings_and_the_clock() -> None:
    with pytest.raises(ParameterError):
        MapSettings(0)
    clock = Clock()
    for _ in range(2):
        with clock.timed("part"):
            pass
    assert list(clock.seconds) == ["part"]
    assert clock.seconds["part"] >= 0.0


def test_some_rays_are_marched_as_among_all() -> None:
    stage = small_stage()
    chosen = torch.tensor([5, 100, 17])
    some = BruteForce(8).gather(stage.with_rays(chosen)).in_scattering
    whole = BruteForce(8).gather(stage).in_scattering
    torch.testing.assert_close(some, whole[chosen])
    assert not torch.allclose(some, whole[:3])
