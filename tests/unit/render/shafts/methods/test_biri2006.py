import math

import pytest
import torch

from render.errors import ParameterError
from render.shafts.casters import make_sphere
from render.shafts.methods import Biri2006, BruteForce
from render.shafts.methods.biri2006 import find_lit_stretches
from render.shafts.ray_casting import RayCaster, SunRays
from render.shafts.rays import ViewRays
from tests.support.shaft_scenes import relative_rms, small_scene, small_stage


def test_borders_are_those_of_the_shadow_of_a_sphere() -> None:
    """The shadow of a sphere of radius 1 under an overhead sun is a cylinder; rays below cross it along chords."""
    caster = RayCaster((make_sphere((0.0, 0.0, 5.0), 1.0, 256),))
    offset = torch.tensor([0.0, 0.3, 0.8, 1.2])
    rays = ViewRays(
        torch.stack([torch.full((4,), -4.0), offset, torch.zeros(4)], dim=1),
        torch.tensor([[1.0, 0.0, 0.0]]).expand(4, 3),
        torch.full((4,), 8.0),
    )
    found = find_lit_stretches(SunRays(caster, (0.0, 0.0, 1.0)), rays, 16, 14)
    half = (1.0 - offset.double().square()).clamp(min=0.0).sqrt() / 8.0
    assert found.ray.tolist() == [0, 0, 1, 1, 2, 2, 3]
    torch.testing.assert_close(found.end[[0, 2, 4]], 0.5 - half[:3], atol=2e-4, rtol=0.0)
    torch.testing.assert_close(found.start[[1, 3, 5]], 0.5 + half[:3], atol=2e-4, rtol=0.0)
    assert (float(found.start[6]), float(found.end[6])) == (0.0, 1.0)
    blunt = find_lit_stretches(SunRays(caster, (0.0, 0.0, 1.0)), rays, 16, 1)
    assert float((blunt.lit_fraction() - found.lit_fraction()).abs().max()) > 2e-3


def test_few_looks_beat_as_many_steps() -> None:
    stage = small_stage(small_scene(24, 16, lamps=False))
    truth = BruteForce(2048).gather(stage).in_scattering
    borders, steps = (method.gather(stage).in_scattering for method in (Biri2006(32, 10, 16), BruteForce(32)))
    assert relative_rms(borders, truth) < 0.7 * relative_rms(steps, truth)
    blunt = Biri2006(32, 1, 16).gather(stage).in_scattering
    assert relative_rms(blunt, truth) > relative_rms(borders, truth)


def test_numbers_without_meaning_are_refused() -> None:
    for wrong in ((0, 1, 1), (1, 0, 1), (1, 1, 0)):
        with pytest.raises(ParameterError):
            Biri2006(*wrong)
    assert Biri2006(4, 5, 6).refined() == Biri2006(8, 5, 12)
    assert math.isclose(Biri2006().at_full_density(9).looks, 9)
