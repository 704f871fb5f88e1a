import math
from dataclasses import replace

import pytest
import torch

from render.errors import ParameterError
from render.shafts.casters import make_box
from render.shafts.lights import PointLight, Sun
from render.shafts.methods import METHODS, Adaptive, BruteForce
from render.shafts.ray_casting import RayCaster, SunRays
from render.shafts.scene import ShaftScene
from render.shafts.soft_lights import split_lamp, split_sun, spread_on_disc, spread_on_sphere
from render.shafts.stage import MapSettings
from tests.support.shaft_scenes import relative_rms, small_scene, small_stage

LAMP = PointLight((1.0, 2.0, 3.0), (8.0, 6.0, 4.0), radius=0.5, shadow_points=16)
SUN = Sun((0.0, 0.6, 0.8), (3.0, 2.0, 1.0), angular_radius=0.05, shadow_points=64)
SMALL = MapSettings(256, 64)


def test_light_is_conserved() -> None:
    for parts, whole in ((split_lamp(LAMP), LAMP.intensity), (split_sun(SUN), SUN.irradiance)):
        light = [getattr(part, "intensity", None) or part.irradiance for part in parts]
        assert torch.tensor(light).sum(0).tolist() == pytest.approx(whole, rel=1e-5)
        assert not any(part.shadow_points > 1 for part in parts)
    assert split_lamp(replace(LAMP, shadow_points=1)) == (replace(LAMP, shadow_points=1),)
    assert split_sun(replace(SUN, shadow_points=1)) == (replace(SUN, shadow_points=1),)


def test_points_lie_evenly_on_sphere_and_disc() -> None:
    sphere = torch.tensor(spread_on_sphere(500), dtype=torch.float64)
    torch.testing.assert_close(sphere.square().sum(1), torch.ones(500, dtype=torch.float64))
    # Means of x, y, z and of their squares over the sphere are 0 and 1/3.
    assert float(sphere.mean(0).abs().max()) < 0.01
    assert sphere.square().mean(0).tolist() == pytest.approx([1.0 / 3.0] * 3, abs=0.005)
    disc = torch.tensor(spread_on_disc(500), dtype=torch.float64)
    assert float(disc.mean(0).abs().max()) < 0.01
    assert disc.square().mean(0).tolist() == pytest.approx([0.25] * 2, abs=0.005)
    away = torch.tensor([part.position for part in split_lamp(LAMP)]) - torch.tensor(LAMP.position)
    torch.testing.assert_close(torch.linalg.vector_norm(away, dim=1), torch.full((16,), 0.5))
    toward = torch.tensor([part.direction for part in split_sun(SUN)]) @ torch.tensor(SUN.direction)
    assert 0.04 < float(toward.arccos().max()) < 0.05


def test_behind_an_edge_the_lit_share_is_that_of_the_disc() -> None:
    """A wide wall below the sun hides a segment of its disc: 1 - share = (arccos(h) - h sqrt(1 - h^2)) / pi at height h of the disc."""
    sun = Sun((0.0, 1.0, 0.0), (1.0, 1.0, 1.0), angular_radius=0.05, shadow_points=256)
    caster = RayCaster((make_box((-500.0, 10.0, -500.0), (500.0, 10.001, 0.0)),))
    height = torch.linspace(-0.9, 0.9, 13)
    points = torch.zeros(13, 3)
    points[:, 2] = -10.0 * math.tan(0.05) * height
    lit = torch.stack([SunRays(caster, part.direction).look_up_lit(points).float() for part in split_sun(sun)]).mean(0)
    wanted = (height.arccos() - height * (1.0 - height.square()).sqrt()) / math.pi
    assert float((lit - wanted).abs().max()) < 0.02
    assert float((lit - wanted.flip(0)).abs().max()) > 0.5


def soft(points: int, lamp_radius: float, sun_radius: float) -> ShaftScene:
    scene = small_scene()
    assert scene.sun is not None
    lamp = replace(scene.lights[0], radius=lamp_radius, shadow_points=points)
    return replace(scene, sun=replace(scene.sun, angular_radius=sun_radius, shadow_points=points), lights=(lamp,))


def light_of(scene: ShaftScene) -> torch.Tensor:
    return BruteForce(64).gather(small_stage(scene, SMALL)).in_scattering


def test_small_lights_are_points() -> None:
    point = light_of(soft(1, 1e-3, 0.0))
    assert relative_rms(light_of(soft(8, 1e-3, 1e-6)), point) < 2e-3
    assert relative_rms(light_of(soft(8, 3.0, 0.1)), point) > 0.02


def test_more_points_converge() -> None:
    fine = light_of(soft(64, 2.0, 0.08))
    errors = [relative_rms(light_of(soft(points, 2.0, 0.08)), fine) for points in (2, 6, 18)]
    assert errors[2] < errors[1] < errors[0]
    assert errors[2] < 0.5 * errors[0]


def test_every_method_takes_soft_lights() -> None:
    stage = small_stage(soft(3, 1.0, 0.05), SMALL)
    assert len(stage.lighting.suns) == len(stage.lighting.points) == 3
    assert stage.lighting.names == "3 points of the sun and 3 lamps"
    exact = BruteForce(256).gather(stage).in_scattering
    for name, method in METHODS.items():
        dense = method.at_full_density(256).gather(stage).in_scattering
        assert relative_rms(dense, exact) < 0.02, name
    assert relative_rms(Adaptive().gather(stage).in_scattering, exact) < 0.03
    one_sun = replace(stage, lighting=replace(stage.lighting, more_suns=()))
    assert relative_rms(BruteForce(256).gather(one_sun).in_scattering, exact) > 0.3


def test_lights_that_cannot_be_are_refused() -> None:
    for wrong in (0, 1000):
        with pytest.raises(ParameterError, match="points that cast"):
            replace(LAMP, shadow_points=wrong)
        with pytest.raises(ParameterError, match="points that cast"):
            replace(SUN, shadow_points=wrong)
    with pytest.raises(ParameterError, match="radius of the sun"):
        replace(SUN, angular_radius=-0.1)
