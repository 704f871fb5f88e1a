"""Degrees at the boundaries."""

import math

import pytest

from render.units import degrees_from_radians, radians_from_degrees


def test_degrees_and_radians() -> None:
    assert radians_from_degrees(180.0) == math.pi
    assert degrees_from_radians(math.pi / 2.0) == 90.0
    assert degrees_from_radians(radians_from_degrees(-37.5)) == pytest.approx(-37.5, rel=1e-15)
    assert radians_from_degrees(1.0) != pytest.approx(degrees_from_radians(1.0))
