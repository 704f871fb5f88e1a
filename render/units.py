"""The units of every public quantity: metres [m], radians [rad], coefficients per metre [1/m].

Other units exist at the boundaries only (command line and files) and are converted by the functions below, once.
Colours are linear, relative to the exposure of the photograph, dimensionless.
"""

import math

LENGTH = "m"
ANGLE = "rad"
COEFFICIENT = "1/m"

METRES_PER_NANOMETRE = 1e-9
METRES_PER_KILOMETRE = 1e3


def radians_from_degrees(angle_deg: float) -> float:
    """Angle [rad] from an angle in degrees."""
    return math.radians(angle_deg)


def degrees_from_radians(angle: float) -> float:
    """Angle in degrees from an angle [rad]."""
    return math.degrees(angle)
