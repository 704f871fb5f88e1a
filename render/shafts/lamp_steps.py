"""Steps of a ray as a lamp sees them: places, shares and steps in the angle at the lamp.

With t the distance along a ray from the place nearest to the lamp and h the distance of that place, the light along the ray is

    dt / (h^2 + t^2) = d(theta) / h,  t = h tan(theta)

so that it is even over the angle, and steps of equal angles have equal light (Kulla & Fajardo 2012, "Importance sampling techniques
for path tracing in participating media", equiangular sampling). A lamp that is a sphere of radius r has h^2 + r^2 in the place of h^2.
"""

import math

import torch
from torch import Tensor

from render.camera import Vector
from render.errors import ParameterError
from render.shafts.rays import ViewRays


def find_closest(rays: ViewRays, position: Vector, radius: float) -> tuple[Tensor, Tensor]:
    """Where rays pass a lamp.

    Args:
        rays: any number.
        position: of the lamp [m].
        radius: r [m], positive.

    Returns:
        Place along each ray that is nearest to the lamp [m], and h^2 + r^2 [m^2], each `(ray, 1)`.
    """
    offset = rays.origin.new_tensor(position) - rays.origin
    nearest = (offset * rays.direction).sum(-1, keepdim=True)
    aside = offset - nearest * rays.direction
    return nearest, aside.square().sum(-1, keepdim=True) + radius * radius


def angles_at_lamp(rays: ViewRays, distances: Tensor, position: Vector, radius: float) -> Tensor:
    """Angles theta `(ray, place)` [rad] of places along rays, 0 nearest to the lamp; in float64, for far ones have no digits in float32.

    Args:
        rays: any number.
        distances: from the eye `(ray, place)` [m].
        position: of the lamp [m].
        radius: r [m], positive.
    """
    nearest, aside = find_closest(rays, position, radius)
    return torch.atan2((distances - nearest).double(), aside.double().sqrt())


def distances_at_angles(rays: ViewRays, angles: Tensor, position: Vector, radius: float) -> Tensor:
    """The inverse of `angles_at_lamp`: distances [m] of angles `(ray, place)` [rad]."""
    nearest, aside = find_closest(rays, position, radius)
    return nearest + aside.sqrt() * torch.tan(angles)


def brightest_places(rays: ViewRays, edges: Tensor, position: Vector, radius: float) -> Tensor:
    """Places in steps that have half the light of 1 / (d^2 + r^2) before and half behind them.

    They halve the angle that a step subtends at the distance h beside the ray: with the ends u and w along the ray, counted from
    the place nearest to the point, that is (u sqrt(h^2 + w^2) + w sqrt(h^2 + u^2)) / (sqrt(h^2 + u^2) + sqrt(h^2 + w^2)).

    Args:
        rays: where the steps lie.
        edges: borders `(ray, step + 1)` [m].
        position: of the point [m].
        radius: r [m], positive.

    Returns:
        Distances along the rays `(ray, step)` [m].
    """
    nearest, aside = find_closest(rays, position, radius)
    along = edges - nearest
    away = (aside + along.square()).sqrt()
    u, w, near, far = along[:, :-1], along[:, 1:], away[:, :-1], away[:, 1:]
    return nearest + (u * far + w * near) / (near + far)


def inverse_square_mean(rays: ViewRays, edges: Tensor, position: Vector, radius: float) -> Tensor:
    """Mean over each step of 1 / (d^2 + r^2), d the distance to a point.

        integral of dt / (h^2 + t^2) from a to b = atan(h (b - a) / (h^2 + a b)) / h

    with h^2 the squared distance between ray and point, plus r^2.

    Arguments are those of `brightest_places`, whose `radius` is r.

    Returns:
        `(ray, step)` [1/m^2].
    """
    nearest, aside = find_closest(rays, position, radius)
    h = aside.sqrt()
    first, last = edges[:, :-1] - nearest, edges[:, 1:] - nearest
    length = last - first
    integral = torch.atan2(h * length, h * h + first * last) / h
    return torch.where(length > 0.0, integral / torch.where(length > 0.0, length, 1.0), 1.0 / (h * h + first * first))


def edges_towards_lamp(rays: ViewRays, position: Vector, radius: float, steps: int) -> Tensor:
    """Borders of steps that subtend equal angles at a lamp, before and behind the place nearest to it.

    Where a ray passes the lamp, that place is a border: there the light turns from forward to backward scattering, next to the
    lamp at once. A ray that subtends half a turn has all of the steps, others as many as their angle asks for; their further steps
    have no length.

    Args:
        rays: any number.
        position: of the lamp [m].
        radius: of the lamp [m], positive.
        steps: of half a turn, at least 2.

    Returns:
        `(ray, step + 1)` [m], from 0 to the length of the ray.

    Raises:
        ParameterError: for fewer steps.
    """
    if steps < 2:
        raise ParameterError(f"expected at least two steps, one on each side of a lamp, got {steps}")
    nearest, aside = find_closest(rays, position, radius)
    h, length = aside.sqrt(), rays.distance[:, None]
    first, last = torch.atan2(-nearest, h), torch.atan2(length - nearest, h)
    border = first.clamp(min=0.0) + last.clamp(max=0.0)
    before = (steps / math.pi * (border - first)).ceil().clamp(max=steps - 1.0)
    behind = torch.minimum((steps / math.pi * (last - border)).ceil(), steps - before)
    number = torch.arange(steps + 1, dtype=h.dtype, device=h.device)
    near = (border - first) * (number / before.clamp(min=1.0)).clamp(max=1.0)
    far = (last - border) * ((number - before) / behind.clamp(min=1.0)).clamp(0.0, 1.0)
    edges = nearest + h * torch.tan(first + near + far)
    edges = torch.where(number >= before + behind, length, edges)
    edges[:, 0] = 0.0
    return torch.minimum(edges.clamp(min=0.0), length).cummax(dim=1).values
