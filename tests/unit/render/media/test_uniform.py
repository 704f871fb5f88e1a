import math

import pytest
import torch

from render.media import Uniform
from render.media.layer import light_depth
from render.media.sphere import EARTH_RADIUS


def numbers(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_levels_count_from_the_top_or_else_the_base() -> None:
    assert Uniform(0.01, 100.0, 20.0).datum == 100.0
    assert Uniform(0.01, math.inf, 20.0).datum == 20.0
    assert Uniform(0.01, math.inf, -math.inf).datum == 0.0


def test_the_sun_shines_through_what_lies_above_or_below() -> None:
    medium = Uniform(0.01, 100.0)
    depth = light_depth(medium, numbers(-70.0), numbers(0.5))
    assert depth.item() == pytest.approx(0.01 * 70.0 / 0.5)
    assert light_depth(medium, numbers(-70.0), numbers(-0.5)).item() == pytest.approx(0.01 * 30.0 / 0.5)
    assert light_depth(medium, numbers(-70.0), numbers(0.0)).item() == math.inf
    assert light_depth(Uniform(0.01, math.inf), numbers(10.0), numbers(0.5)).item() == math.inf


def test_a_level_sun_shines_along_the_chord_of_the_round_layer() -> None:
    """Pythagoras: a level ray leaves a layer of thickness D after sqrt((R + D)^2 - R^2)."""
    medium = Uniform(1e-5, 1000.0)
    chord = math.sqrt((EARTH_RADIUS + 1000.0) ** 2 - EARTH_RADIUS**2)
    depth = medium.curved_depth(numbers(-1000.0), numbers(0.0), EARTH_RADIUS).item()
    assert depth == pytest.approx(1e-5 * chord, rel=2e-4)
    assert depth != pytest.approx(1e-5 * chord, rel=1e-6)
    overhead = medium.curved_depth(numbers(-1000.0), numbers(1.0), EARTH_RADIUS).item()
    assert overhead == pytest.approx(1e-5 * 1000.0, rel=1e-12)
    assert medium.curved_depth(numbers(-1000.0), numbers(-0.01), EARTH_RADIUS).item() == math.inf
