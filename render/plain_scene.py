"""A plain with rows of poles and ridges of hills at rising distances: a scene on which fog shows what it does.

Everything stands on level ground at height 0, in front of the camera. Poles stand in pairs at distances that double; ridges are cut-outs
across the view whose skylines are sums of sines.
"""

from typing import NamedTuple

import torch
from torch import Tensor

POLE_DISTANCES = (30.0, 60.0, 120.0, 240.0, 480.0, 960.0)
"""Of the pairs of poles, along the view [m]."""

POLE_OFFSET, POLE_RADIUS, POLE_HEIGHT = 14.0, 0.9, 16.0
"""Poles stand so far left and right of the middle; their radius and height [m]."""

RIDGES = ((500.0, 34.0), (1100.0, 80.0), (2300.0, 170.0), (4800.0, 360.0), (10_000.0, 800.0))
"""Distance along the view and mean height of each ridge [m]."""

GROUND, POLE, RIDGE = (0.16, 0.17, 0.09), (0.30, 0.26, 0.22), (0.07, 0.10, 0.05)
"""Albedo of grass, weathered stone and wood (red, green, blue) [1], chosen by eye."""


CHUNK = 1 << 14
"""Rays traced at once: their numbers stay in the cache."""


class Surfaces(NamedTuple):
    """What rays meet.

    Args:
        distance: `(ray,)` [m]; infinite for the sky.
        height: of the point that is met `(ray,)` [m]; 0 for the sky.
        normal: unit vectors `(ray, 3)`.
        albedo: `(ray, channel)` [1], 0 for the sky.
    """

    distance: Tensor
    height: Tensor
    normal: Tensor
    albedo: Tensor


def trace_plain(origin: Tensor, direction: Tensor, azimuth: float) -> Surfaces:
    """Find what rays meet.

    Args:
        origin: of the rays `(ray, 3)` [m], above the ground.
        direction: unit vectors `(ray, 3)`.
        azimuth: towards which the poles and ridges stand [rad, clockwise from north].

    Returns:
        The nearest surfaces.
    """
    parts = [_trace(*rays, azimuth) for rays in zip(origin.split(CHUNK), direction.split(CHUNK), strict=True)]
    return Surfaces(*(torch.cat(column) for column in zip(*parts, strict=True)))


def _trace(origin: Tensor, direction: Tensor, azimuth: float) -> Surfaces:
    turn = torch.tensor(azimuth, dtype=direction.dtype)
    forward = torch.stack([turn.sin(), turn.cos(), torch.zeros_like(turn)])
    right = torch.stack([turn.cos(), -turn.sin(), torch.zeros_like(turn)])
    falls = direction[:, 2] < 0.0
    distance = torch.where(falls, origin[:, 2] / -torch.where(falls, direction[:, 2], -1.0), torch.inf)
    up = direction.new_tensor([0.0, 0.0, 1.0]).expand_as(direction)
    albedo = _ground_albedo(origin, direction, distance)
    found = Surfaces(distance, torch.zeros_like(distance), up, torch.where(falls[:, None], albedo, 0.0))
    for number, (away, height) in enumerate(RIDGES):
        found = _nearer(found, _ridge(origin, direction, forward, right, away, height, number))
    for away in POLE_DISTANCES:
        for side in (-POLE_OFFSET, POLE_OFFSET):
            found = _nearer(found, _pole(origin, direction, away * forward + side * right))
    return found


def _nearer(first: Surfaces, second: Surfaces) -> Surfaces:
    closer = second.distance < first.distance
    wide = closer[:, None]
    return Surfaces(
        torch.where(closer, second.distance, first.distance),
        torch.where(closer, second.height, first.height),
        torch.where(wide, second.normal, first.normal),
        torch.where(wide, second.albedo, first.albedo),
    )


def _ground_albedo(origin: Tensor, direction: Tensor, distance: Tensor) -> Tensor:
    """Grass with broad patches, which fade where they become smaller than a pixel."""
    point = origin[:, :2] + direction[:, :2] * torch.where(torch.isinf(distance), 0.0, distance)[:, None]
    x, y = point.unbind(-1)
    patches = torch.sin(0.11 * x + 1.7 * torch.sin(0.07 * y)) * torch.sin(0.09 * y + 1.3 * torch.sin(0.05 * x))
    fading = torch.exp(-torch.where(torch.isinf(distance), 0.0, distance) / 600.0)
    return direction.new_tensor(GROUND) * (1.0 + 0.25 * patches * fading)[:, None]


def _pole(origin: Tensor, direction: Tensor, foot: Tensor) -> Surfaces:
    """An upright cylinder without a lid."""
    flat, offset = direction[:, :2], origin[:, :2] - foot[:2]
    a = flat.square().sum(-1)
    half_b = (flat * offset).sum(-1)
    c = offset.square().sum(-1) - POLE_RADIUS**2
    square = half_b.square() - a * c
    meets = (square > 0.0) & (a > 0.0)
    root = torch.where(meets, square, 0.0).sqrt()
    t = (-half_b - root) / torch.where(a > 0.0, a, 1.0)
    point = origin + t[:, None] * direction
    meets = meets & (t > 0.0) & (point[:, 2] >= 0.0) & (point[:, 2] <= POLE_HEIGHT)
    outwards = torch.cat([(point[:, :2] - foot[:2]) / POLE_RADIUS, torch.zeros_like(t)[:, None]], dim=-1)
    colour = direction.new_tensor(POLE).expand_as(direction)
    return Surfaces(torch.where(meets, t, torch.inf), point[:, 2], outwards, colour)


def _ridge(
    origin: Tensor, direction: Tensor, forward: Tensor, right: Tensor, away: float, height: float, number: int
) -> Surfaces:
    """A cut-out across the view, its slopes leaning back so that they catch the light of the sky."""
    approach = direction @ forward
    t = (away - origin @ forward) / torch.where(approach > 0.0, approach, 1.0)
    point = origin + t[:, None] * direction
    across = point @ right / away
    skyline, _ = _skyline(across, number)
    # Gullies run down aslant, the more the higher the hill.
    _, tilt = _skyline(1.7 * across + 0.9 * point[:, 2] / away, number + 1)
    meets = (approach > 0.0) & (t > 0.0) & (point[:, 2] >= 0.0) & (point[:, 2] <= height * skyline)
    lean = -forward[None] * 0.75 - right[None] * (1.5 * tilt * height / away)[:, None]
    lean = lean + direction.new_tensor([0.0, 0.0, 0.65])
    normal = torch.nn.functional.normalize(lean, dim=-1)
    colour = direction.new_tensor(RIDGE).expand_as(direction)
    return Surfaces(torch.where(meets, t, torch.inf), point[:, 2], normal, colour)


def _skyline(across: Tensor, number: int) -> tuple[Tensor, Tensor]:
    """Height relative to the mean, and its slope, at a place across the view in units of the ridge's distance."""
    value, slope = torch.ones_like(across), torch.zeros_like(across)
    for octave in range(7):
        frequency = 3.1 * 1.9**octave * (1.0 + 0.13 * number)
        phase = 2.4 * number + 1.9 * octave * (number + 1)
        size = 0.42 * 0.55**octave
        value = value + size * torch.sin(frequency * across + phase)
        slope = slope + size * frequency * torch.cos(frequency * across + phase)
    return value.clamp(min=0.05), slope
