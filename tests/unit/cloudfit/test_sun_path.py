import math

import pytest

from cloudfit.sun_path import find_sun


def degrees(hour: float, latitude: float, day: float) -> tuple[float, float]:
    azimuth, elevation = find_sun(hour, math.radians(latitude), day)
    return math.degrees(azimuth), math.degrees(elevation)


def test_noon_stands_in_the_south_by_the_tilt() -> None:
    azimuth, elevation = degrees(12.0, 47.0, 172.0)
    assert azimuth == pytest.approx(180.0)
    assert elevation == pytest.approx(90.0 - 47.0 + 23.44)
    assert degrees(12.0, 47.0, 172.0 + 365.25 / 2.0)[1] == pytest.approx(90.0 - 47.0 - 23.44)
    assert degrees(12.0, -47.0, 172.0)[0] % 360.0 == pytest.approx(0.0, abs=1e-9)


def test_the_sun_rises_in_the_east_at_six_when_day_and_night_are_equal() -> None:
    day = 172.0 - 365.25 / 4.0
    assert degrees(6.0, 47.0, day) == pytest.approx((90.0, 0.0), abs=1e-9)
    assert degrees(18.0, 47.0, day) == pytest.approx((270.0, 0.0), abs=1e-9)
    assert degrees(9.0, 47.0, day)[0] < 180.0 < degrees(15.0, 47.0, day)[0]
    assert degrees(0.0, 47.0, day)[1] < -40.0
