import math

import pytest
import torch

from render.camera import direction_from_angles
from render.errors import ParameterError
from render.media import ExponentialDecay, Uniform
from render.shafts.air import Air, Constituent
from render.shafts.lights import AlwaysLit, Lighting, PointInScene, PointLight, Sun, SunInScene, build_sun_depth

AIR = Air((Constituent(ExponentialDecay(1e-3, 100.0), (1.0, 2.0, 0.5)), Constituent(Uniform(2e-3, 50.0))))


def sun_at(elevation_deg: float, round_ground: bool = True) -> Sun:
    return Sun(direction_from_angles(0.3, math.radians(elevation_deg)), round_ground=round_ground)


def test_the_depth_to_a_high_sun_is_that_of_the_closed_forms() -> None:
    height = torch.tensor([0.0, 20.0, 80.0], dtype=torch.float64)
    slope = math.sin(math.radians(40.0))
    exponential, uniform = 0.1 * torch.exp(-height / 100.0), 2e-3 * (50.0 - height).clamp(min=0.0)
    wanted = (exponential[:, None] * torch.tensor([1.0, 2.0, 0.5], dtype=torch.float64) + uniform[:, None]) / slope
    torch.testing.assert_close(sun_at(40.0).compute_depth(AIR, height), wanted, rtol=1e-9, atol=1e-12)


def test_a_level_sun_shines_over_round_ground_only() -> None:
    height = torch.tensor([10.0], dtype=torch.float64)
    assert torch.isinf(sun_at(0.0, False).compute_depth(AIR, height)).all()
    assert torch.isfinite(sun_at(0.0).compute_depth(AIR, height)).all()
    assert torch.isinf(sun_at(-5.0).compute_depth(AIR, height)).all()


def test_the_table_meets_the_formula_between_its_heights() -> None:
    table = build_sun_depth(AIR, sun_at(30.0), -5.0, 300.0)
    height = torch.linspace(0.0, 299.0, 977, dtype=torch.float64)
    exact = sun_at(30.0).compute_depth(AIR, height)
    assert float((table.look_up(height) - exact).abs().max()) < 5e-5  # at the base of the fog, where the slope changes
    coarse = build_sun_depth(AIR, sun_at(30.0), -5.0, 300.0, 64)
    assert float((coarse.look_up(height) - exact).abs().max()) > 1e-4


def test_a_table_beside_the_shadow_of_the_ground_has_no_nan() -> None:
    table = build_sun_depth(AIR, sun_at(-1.0), 0.0, 5000.0, 200)
    found = table.look_up(torch.linspace(-10.0, 6000.0, 3001))
    assert not torch.isnan(found).any()
    assert torch.isinf(found).any()
    assert torch.isfinite(found).any()


def test_the_window_of_a_lamp_ends_at_its_reach() -> None:
    lamp = PointLight((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), reach=10.0)
    window = lamp.window(torch.tensor([0.0, 5.0, 10.0, 20.0]))
    torch.testing.assert_close(window, torch.tensor([1.0, (1.0 - 0.0625) ** 2, 0.0, 0.0]))
    assert PointLight((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)).window(torch.tensor(1e6)) == 1.0


def test_lights_are_told_apart() -> None:
    point = PointInScene(PointLight((0.0, 0.0, 1.0), (1.0, 1.0, 1.0)), AlwaysLit())
    sun = SunInScene(sun_at(20.0), build_sun_depth(Air(), sun_at(20.0), 0.0, 0.0), AlwaysLit())
    lighting = Lighting(sun, (point, point))
    assert [(part.sun is not None, len(part.points)) for part in lighting.separate()] == [
        (True, 0),
        (False, 1),
        (False, 1),
    ]
    assert lighting.names == "the sun and 2 lamps"
    assert Lighting().names == "no light"


def test_what_is_no_light_is_refused() -> None:
    with pytest.raises(ParameterError, match="unit vector"):
        Sun((0.0, 0.0, 2.0))
    with pytest.raises(ParameterError, match="irradiance"):
        Sun((0.0, 0.0, 1.0), (1.0, math.nan, 1.0))
    for wrong in ({"radius": 0.0}, {"reach": 0.0}, {"position": (math.inf, 0.0, 0.0)}, {"intensity": (-1.0, 0.0, 0.0)}):
        with pytest.raises(ParameterError):
            PointLight(**{"position": (0.0, 0.0, 0.0), "intensity": (1.0, 1.0, 1.0), **wrong})
