import math
from dataclasses import replace

import pytest
import torch

from cloudfit.commands.fog_choice import FogChoice, parse_colour
from render.errors import ParameterError
from render.media import MEDIA, compute_optical_depth

CHOICE = FogChoice(
    medium="linear",
    visibility=300.0,
    fog_height=60.0,
    fog_base=20.0,
    asymmetry=0.7,
    albedo=0.9,
    sun_azimuth=90.0,
    sun_elevation=30.0,
    sun_colour="1,0.5,0.25",
    sun_intensity=2.0,
    ambient=0.5,
    eye_height=10.0,
    camera_azimuth=0.0,
    camera_elevation=0.0,
    camera_fov=40.0,
)


@pytest.mark.parametrize("name", MEDIA)
def test_visibility_is_that_at_the_base(name: str) -> None:
    medium = replace(CHOICE, medium=name).build_medium()
    base = torch.tensor(20.0, dtype=torch.float64)
    assert torch.exp(-compute_optical_depth(medium, base, 0.0, 300.0)).item() == pytest.approx(0.05)
    assert torch.exp(-compute_optical_depth(medium, base - 1.0, 0.0, 300.0)).item() == 1.0
    thin = replace(CHOICE, medium=name).build_medium(4.0)
    assert torch.exp(-compute_optical_depth(thin, base, 0.0, 1200.0)).item() == pytest.approx(0.05)


def test_the_sun_stands_where_and_shines_as_it_is_told() -> None:
    direction, light = CHOICE.sun()
    torch.testing.assert_close(direction, torch.tensor([math.sqrt(0.75), 0.0, 0.5], dtype=torch.float64))
    assert light.tolist() == [2.0, 1.0, 0.5]
    low, high = (replace(CHOICE, sun_colour=None, sun_elevation=e).sun()[1] for e in (3.0, 60.0))
    assert low[2] / low[0] < high[2] / high[0]


def test_a_white_surface_is_the_unit_of_light() -> None:
    direction, light = CHOICE.sun()
    made = CHOICE.light(direction, light, torch.ones(3))
    torch.testing.assert_close(made.irradiance, math.pi * light)
    assert made.ambient.tolist() == [0.5, 0.5, 0.5]
    assert (made.asymmetry, made.albedo) == (0.7, 0.9)


def test_colours_are_three_numbers() -> None:
    assert parse_colour("1, 0.5,0") == (1.0, 0.5, 0.0)
    for text in ("1,2", "1,2,nan", "1,2,-1", "1,2,3,4", ""):
        with pytest.raises(ParameterError, match=r"red,green,blue|at least 0"):
            parse_colour(text)
