"""Where the sun stands at a time of day, by the geometry of a round orbit."""

import math

TILT = math.radians(23.44)
"""Of the earth's axis [rad]."""

SOLSTICE_DAY, YEAR = 172.0, 365.25
"""Day of the year of the northern summer solstice, and the days of a year."""


def find_sun(hour: float, latitude: float, day: float) -> tuple[float, float]:
    """Azimuth and elevation of the sun.

        sin(elevation) = sin(latitude) sin(declination) + cos(latitude) cos(declination) cos(hour angle)

    without refraction and the equation of time, which together matter less than a degree and 17 minutes.

    Args:
        hour: local solar time, 0..24 [h]; 12 is noon.
        latitude: [rad], north positive.
        day: of the year, 1..366.

    Returns:
        Azimuth [rad, clockwise from north] and elevation [rad].
    """
    declination = TILT * math.cos(2.0 * math.pi * (day - SOLSTICE_DAY) / YEAR)
    turned = math.radians(15.0 * (hour - 12.0))
    east = -math.cos(declination) * math.sin(turned)
    north = math.cos(latitude) * math.sin(declination) - math.sin(latitude) * math.cos(declination) * math.cos(turned)
    up = math.sin(latitude) * math.sin(declination) + math.cos(latitude) * math.cos(declination) * math.cos(turned)
    return math.atan2(east, north) % (2.0 * math.pi), math.asin(min(max(up, -1.0), 1.0))
