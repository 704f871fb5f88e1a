"""Rays in a spherical shell of air: where they are, how high the sun stands there, and where they end.

A ray is given by the distance r of its origin from the planet's centre [m], the cosine mu between its direction and the zenith,
the cosine mu_s between sun and zenith, and the cosine nu between ray and sun. At the distance d along it (law of cosines)

    r_d^2 = r^2 + 2 r mu d + d^2,     mu_d = (r mu + d) / r_d,     mu_s_d = (r mu_s + d nu) / r_d

Everything here is float64. Of the two roots of a quadratic the one that would cancel is taken from the product of both. Where squares of
radii are subtracted, r^2 - R^2 is good to 0.01 m^2, because a last bit of r is worth as much: on the ground, where the difference is zero,
its root is good to 0.1 m, and so is the length of a ray that grazes the ground. These two differences stand as in Bruneton's
reference: a product of sum and difference would be no better in float64, and its other last bits would show in the seventh digit
when tables are compared. In float32 the same roots would be wrong by 2 km.

Four guards keep rounding from leaving a domain: `clamp_cosine`, `clamp_radius`, `clamp_distance` and `safe_sqrt`. All arguments of a
function broadcast against each other.
"""

import torch
from torch import Tensor

from render.atmosphere.parameters import AtmosphereParameters


def clamp_cosine(cosine: Tensor) -> Tensor:
    """A cosine within -1..1."""
    return cosine.clamp(-1.0, 1.0)


def clamp_distance(distance: Tensor) -> Tensor:
    """A distance [m] that is not negative."""
    return distance.clamp(min=0.0)


def clamp_radius(atmosphere: AtmosphereParameters, radius: Tensor) -> Tensor:
    """A distance from the centre [m] between the ground and the top of the air."""
    return radius.clamp(atmosphere.bottom_radius, atmosphere.top_radius)


def safe_sqrt(square: Tensor) -> Tensor:
    """Square root, zero for what rounding made negative; its gradient is zero there instead of infinite."""
    positive = square > 0.0
    return torch.where(positive, torch.where(positive, square, 1.0).sqrt(), 0.0)


def sine_from_cosine(cosine: Tensor) -> Tensor:
    """Sine, at least zero, of the angle with this cosine: sqrt((1 - c)(1 + c))."""
    return safe_sqrt((1.0 - cosine) * (1.0 + cosine))


def horizon_distance(atmosphere: AtmosphereParameters, radius: Tensor) -> Tensor:
    """Length of the tangent from a point to the ground: sqrt(r^2 - R^2).

    Args:
        atmosphere: the planet, its ground at R.
        radius: of the point from the centre `(...)` [m].

    Returns:
        Distance `(...)` [m], zero on the ground.
    """
    return safe_sqrt(radius * radius - atmosphere.bottom_radius**2)


def horizon_cosine(atmosphere: AtmosphereParameters, radius: Tensor) -> Tensor:
    """Cosine between the zenith and the rays that graze the ground: -sqrt(1 - (R/r)^2).

    Args:
        atmosphere: the planet, its ground at R.
        radius: of the point from the centre `(...)` [m].

    Returns:
        Cosine `(...)`, zero on the ground, negative above it.
    """
    return -horizon_distance(atmosphere, radius) / radius


def _half_chord_squared(boundary: float, radius: Tensor, cosine: Tensor) -> Tensor:
    """r^2 (mu^2 - 1) + b^2: squared half length of the line's chord of the sphere of radius b; negative where it misses."""
    return radius * radius * (cosine * cosine - 1.0) + boundary * boundary


def distance_to_top_boundary(atmosphere: AtmosphereParameters, radius: Tensor, cosine: Tensor) -> Tensor:
    """Distance along a ray to the top of the air.

        d = -r mu + sqrt(r^2 (mu^2 - 1) + r_top^2)

    Args:
        atmosphere: the planet, its air ends at r_top.
        radius: of the origin from the centre, at most r_top `(...)` [m].
        cosine: between ray and zenith `(...)`.

    Returns:
        Distance `(...)` [m], at least zero.
    """
    top = atmosphere.top_radius
    ahead = radius * cosine
    root = safe_sqrt(_half_chord_squared(top, radius, cosine))
    total = ahead.abs() + root
    other = (top - radius) * (top + radius) / torch.where(total > 0.0, total, 1.0)
    return clamp_distance(torch.where(ahead > 0.0, other, root - ahead))


def distance_to_bottom_boundary(atmosphere: AtmosphereParameters, radius: Tensor, cosine: Tensor) -> Tensor:
    """Distance along a ray to the ground, for rays that meet it.

        d = -r mu - sqrt(r^2 (mu^2 - 1) + R^2)

    Args:
        atmosphere: the planet, its ground at R.
        radius: of the origin from the centre, at least R `(...)` [m].
        cosine: between ray and zenith `(...)`.

    Returns:
        Distance `(...)` [m], at least zero; for a ray that passes the ground, that to its lowest point.
    """
    bottom = atmosphere.bottom_radius
    ahead = radius * cosine
    chord = _half_chord_squared(bottom, radius, cosine)
    root = safe_sqrt(chord)
    total = ahead.abs() + root
    nearer = (radius - bottom) * (radius + bottom) / torch.where(total > 0.0, total, 1.0)
    return clamp_distance(torch.where((ahead < 0.0) & (chord > 0.0), nearer, -ahead - root))


def ray_intersects_ground(atmosphere: AtmosphereParameters, radius: Tensor, cosine: Tensor) -> Tensor:
    """Whether a ray meets the ground.

    Decide it once for a ray and hand it on: near the horizon the same question asked at a point along the ray may get another
    answer, for no other reason than rounding.

    Args:
        atmosphere: the planet.
        radius: of the origin from the centre `(...)` [m].
        cosine: between ray and zenith `(...)`.

    Returns:
        Booleans `(...)`. A ray that touches the ground meets it; one that looks up from it, or along it, does not.
    """
    return (cosine < 0.0) & (_half_chord_squared(atmosphere.bottom_radius, radius, cosine) >= 0.0)


def distance_to_nearest_boundary(
    atmosphere: AtmosphereParameters, radius: Tensor, cosine: Tensor, intersects_ground: Tensor
) -> Tensor:
    """Distance along a ray to where it leaves the air, the ground or the top [m]; arguments and shape as above."""
    return torch.where(
        intersects_ground,
        distance_to_bottom_boundary(atmosphere, radius, cosine),
        distance_to_top_boundary(atmosphere, radius, cosine),
    )


def radius_along_ray(atmosphere: AtmosphereParameters, radius: Tensor, cosine: Tensor, distance: Tensor) -> Tensor:
    """Distance from the centre of a point on a ray, r_d above, kept within the air.

    Args:
        atmosphere: the planet.
        radius: of the origin from the centre `(...)` [m].
        cosine: between ray and zenith `(...)`.
        distance: along the ray `(...)` [m].

    Returns:
        Distance from the centre `(...)` [m].
    """
    return clamp_radius(atmosphere, _unclamped_radius(radius, cosine, distance))


def _unclamped_radius(radius: Tensor, cosine: Tensor, distance: Tensor) -> Tensor:
    """r_d, exactly r where the distance is zero: on the ground a last bit of r is worth 0.1 m of the distance to the horizon."""
    return safe_sqrt(radius * radius + distance * (distance + 2.0 * radius * cosine))


def view_cosine_along_ray(radius: Tensor, cosine: Tensor, distance: Tensor, radius_there: Tensor) -> Tensor:
    """Cosine between ray and zenith at a point on the ray, mu_d above; radii and distance [m], all `(...)`."""
    return clamp_cosine((radius * cosine + distance) / radius_there)


def sun_cosine_along_ray(
    radius: Tensor, cos_sun_zenith: Tensor, cos_view_sun: Tensor, distance: Tensor, radius_there: Tensor
) -> Tensor:
    """Cosine between sun and zenith at a point on the ray, mu_s_d above; radii and distance [m], all `(...)`."""
    return clamp_cosine((radius * cos_sun_zenith + distance * cos_view_sun) / radius_there)
