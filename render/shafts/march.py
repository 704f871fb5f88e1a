"""In-scattered light along view rays, step by step: the march that every method is made of.

A step of the ray from a to b, of optical depth dtau, adds

    sun:   V dtau_s p(cosine) irradiance  mean of exp(-(tau + A))
    lamp:  V sigma_s p(cosine) intensity w  mean of exp(-(tau + A))  integral of dt / (d(t)^2 + r^2)

with tau the optical depth from the eye, A that to the light through the layers of the air, dtau_s the part of dtau that is scattered,
sigma_s the extinction that scatters, and V the share of the step that sees the light (`ShadowLooks`), times exp(-A) of the banks of fog
between the middle of the step and the light. The means are those of exponents that run evenly, and the last integral is an arc tangent. So
a single medium without shadows under the sun comes out exactly, with any number of steps, and the inverse square of a near light costs
no accuracy: the steps have to resolve shadows and banks of fog, not the layers of the air.

The light of a lamp is spread evenly over the angle at which the lamp sees the step (Kulla & Fajardo 2012, "Importance sampling
techniques for path tracing in participating media"), so all that varies is taken in the middle of that angle, and V is a share of the
angle. A long step has nearly all of its light next to the lamp: the mean of a factor over its length is not that over its light.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from render.errors import ParameterError
from render.fused import fused_loops_wanted
from render.media.special_functions import exponential_mean
from render.shafts.air import Air, Constituent
from render.shafts.cube_shadow_map import CubeShadowMap
from render.shafts.fog_bank import Shades, look_up_shade
from render.shafts.lamp_steps import angles_at_lamp, brightest_places, distances_at_angles, inverse_square_mean
from render.shafts.lights import AlwaysLit, Lighting, PointInScene, SunInScene, Visibility
from render.shafts.rays import ViewRays
from render.shafts.shadow_map import ShadowMap


@dataclass(frozen=True)
class ShadowLooks:
    """How the lit share of a step is found.

    Without halvings, shadows are looked up in the middles of `count` equal parts of the step. With halvings they are looked up at the
    ends of the parts; where one end is lit and the other is not, the border between them is halved in so many times, as if the part held
    no other border. Parts and middles are those of its length for the sun, and of the angle under which it is seen for a lamp.

    Args:
        count: parts of a step, at least 1.
        halvings: of a part with a border, at least 0.

    Raises:
        ParameterError: for fewer.
    """

    count: int = 1
    halvings: int = 0

    def __post_init__(self) -> None:
        if self.count < 1 or self.halvings < 0:
            raise ParameterError(f"expected at least one look for shadows and no negative halvings, got {self}")


ONE_LOOK = ShadowLooks()
"""In the middle of each step."""


@dataclass(frozen=True, eq=False)
class MarchedLight:
    """Outcome of a march.

    Args:
        in_scattering: light that the air adds `(ray, channel)`.
        depth: optical depth of the rays `(ray, channel)` [1].
    """

    in_scattering: Tensor
    depth: Tensor


def march(
    air: Air, lighting: Lighting, rays: ViewRays, edges: Tensor, spent: float = 0.0, looks: ShadowLooks = ONE_LOOK
) -> MarchedLight:
    """March along rays.

    Args:
        air: what scatters.
        lighting: what lights it.
        rays: where to.
        edges: borders of the steps `(ray, step + 1)` [m], rising from 0 to the length of the ray.
        spent: transmittance [1] at which a ray may be left; 0 for never. The torch loop takes no notice.
        looks: how shadows are looked up.

    Returns:
        Light and optical depth. The depth of a ray that was left early is that of its whole length.
    """
    return MarchedLight(gather_light(air, lighting, rays, edges, spent, looks), air.compute_ray_depths(rays)[0])


def gather_light(
    air: Air, lighting: Lighting, rays: ViewRays, edges: Tensor, spent: float = 0.0, looks: ShadowLooks = ONE_LOOK
) -> Tensor:
    """The light of `march` alone `(ray, channel)`."""
    if lighting.more_suns:
        light = gather_light(air, replace(lighting, more_suns=()), rays, edges, spent, looks)
        for sun in lighting.more_suns:
            light += gather_light(air, Lighting(sun), rays, edges, spent, looks)
        return light
    if fused_loops_wanted(edges, rays.origin) and edges.dtype == torch.float32 and _mapped(lighting):
        from render.shafts.fused_march import march_fused

        return march_fused(air, lighting, rays, edges, spent, looks)
    return _march(air, lighting, rays, edges, looks)


def _mapped(lighting: Lighting) -> bool:
    """Whether all shadows come from maps, which the fused loop reads."""
    sun = lighting.sun is None or isinstance(lighting.sun.visibility, ShadowMap | AlwaysLit)
    return sun and all(isinstance(point.visibility, CubeShadowMap | AlwaysLit) for point in lighting.points)


def _march(air: Air, lighting: Lighting, rays: ViewRays, edges: Tensor, looks: ShadowLooks) -> Tensor:
    height = rays.origin[:, 2:] + rays.direction[:, 2:] * edges
    lengths = edges.diff(dim=1)
    steps = _measure_steps(air, rays, edges, height, lengths)
    if not steps:
        return edges.new_zeros(len(rays), 3)
    depth = torch.nn.functional.pad(sum(steps[1:], steps[0]).cumsum(dim=1), (0, 0, 1, 0))
    light = edges.new_zeros(len(rays), 3)
    if lighting.sun is not None:
        lit = _lit_share(lighting.sun.visibility, rays, edges, looks, lambda places, _: places)
        left = lit[..., None] * _bank_transmittance(air, lighting.sun.shades, rays, edges)
        light = light + _sunlight(air, lighting.sun, rays, height, steps, depth, left)
    for point in lighting.points:
        lit = _lamp_share(point, rays, edges, looks)
        light = light + _point_light(air, point, rays, edges, steps, depth, lit)
    return light


def _measure_steps(air: Air, rays: ViewRays, edges: Tensor, height: Tensor, lengths: Tensor) -> list[Tensor]:
    """Optical depth of each step `(ray, step, channel)` [1], for each of the air's particles."""
    steps = [part.compute_depth(height[:, :-1], rays.direction[:, 2:], lengths) for part in air.constituents]
    if air.banks:
        middles = rays.points_at(0.5 * (edges[:, :-1] + edges[:, 1:]))
        steps += [bank.compute_depth(middles, lengths) for bank in air.banks]
    return steps


def _bank_transmittance(air: Air, shades: Shades, rays: ViewRays, edges: Tensor) -> Tensor | float:
    """What banks of fog leave of a light in the middles of the steps `(ray, step, channel)` [1]."""
    if not air.banks:
        return 1.0
    return torch.exp(-look_up_shade(air.banks, shades, rays.points_at(0.5 * (edges[:, :-1] + edges[:, 1:]))))


def _sunlight(
    air: Air, sun: SunInScene, rays: ViewRays, height: Tensor, steps: list[Tensor], depth: Tensor, left: Tensor
) -> Tensor:
    """Sunlight that the steps scatter into the rays `(ray, channel)`, of which casters and banks leave a share."""
    exponent = depth + sun.depth.look_up(height)
    arriving = exponential_mean(exponent[:, :-1], exponent[:, 1:]) * left
    cosine = (rays.direction @ rays.direction.new_tensor(sun.light.direction)).clamp(-1.0, 1.0)
    light = torch.zeros_like(depth[:, 0])
    for part, step in zip(air.particles, steps, strict=True):
        light = light + part.albedo * part.evaluate_phase(cosine)[:, None] * (step * arriving).sum(1)
    return light * light.new_tensor(sun.light.irradiance)


def _point_light(
    air: Air, point: PointInScene, rays: ViewRays, edges: Tensor, steps: list[Tensor], depth: Tensor, lit: Tensor
) -> Tensor:
    """Light of a point light that the steps scatter into the rays `(ray, channel)`."""
    light = point.light
    places, length = brightest_places(rays, edges, light.position, light.radius), edges.diff(dim=1)
    middles = rays.points_at(places)
    towards = middles.new_tensor(light.position) - middles
    distance = torch.linalg.vector_norm(towards, dim=-1)
    unit = towards / torch.where(distance > 0.0, distance, 1.0)[..., None]
    cosine = (unit * rays.direction[:, None]).sum(-1).clamp(-1.0, 1.0)
    between = air.compute_depth(middles[..., 2], unit[..., 2].clamp(-1.0, 1.0), distance)
    share = torch.where(length > 0.0, (places - edges[:, :-1]) / torch.where(length > 0.0, length, 1.0), 0.5)
    run = share * length * cosine / torch.where(distance > 0.0, distance, 1.0)
    arriving = _arriving_from_lamp(depth, between, share[..., None], run[..., None])
    if air.banks:
        arriving = arriving * torch.exp(-look_up_shade(air.banks, point.shades, middles))
    spread = inverse_square_mean(rays, edges, light.position, light.radius) * light.window(distance) * lit
    total = torch.zeros_like(depth[:, 0])
    for part, step in zip(air.particles, steps, strict=True):
        if isinstance(part, Constituent):
            step = part.compute_extinction(middles[..., 2]) * length[..., None]
        weight = part.albedo * part.evaluate_phase(cosine) * spread
        total = total + (weight[..., None] * step * arriving).sum(1)
    return total * total.new_tensor(light.intensity)


def _arriving_from_lamp(depth: Tensor, between: Tensor, share: Tensor, run: Tensor) -> Tensor:
    """What is left of the light of a lamp between it, the steps and the eye `(ray, step, channel)` [1].

    Both depths are taken to run evenly along the step around their values in its middle, before which a `share` of it lies: that to the
    eye by the depth of the step, that to the lamp in proportion to the distance, by a share `run` of it from the beginning to the middle.
    Their sum does not fall, nor is it ever less than the depth before the step.
    """
    inside = share * depth.diff(dim=1)
    middle = depth[:, :-1] + inside + between
    half = torch.minimum((inside - run * between).clamp(min=0.0), inside + between)
    return exponential_mean(middle - half, middle + half)


Place = Callable[[Tensor, ViewRays], Tensor]
"""From the coordinate `(ray, ...)` in which the parts of a step are equal to the distance along the ray [m]."""


def _lit_share(visibility: Visibility, rays: ViewRays, edges: Tensor, looks: ShadowLooks, place: Place) -> Tensor:
    """Share of each step that sees a light `(ray, step)` [1]; the borders of the steps are in any coordinate."""
    count, between = looks.count, 0.5 if looks.halvings == 0 else 0.0
    share = (torch.arange(count + (0 if between else 1), dtype=edges.dtype) + between) / count
    parts = edges[:, :-1, None] + share * edges.diff(dim=1)[..., None]
    places = place(parts.flatten(1), rays)
    lit = visibility.look_up_lit(rays.points_at(places).unflatten(1, parts.shape[1:]))
    if between:
        return lit.to(rays.origin.dtype).mean(-1)
    shares = torch.where(lit[..., 1:] & lit[..., :-1], 1.0, 0.0).to(edges.dtype)
    mixed = torch.nonzero(lit[..., 1:] != lit[..., :-1], as_tuple=True)
    some = rays[mixed[0]]
    shares[mixed] = _halve(visibility, some, parts[..., :-1][mixed], parts[..., 1:][mixed], looks.halvings, place)
    return shares.mean(-1).to(rays.origin.dtype)


def _lamp_share(point: PointInScene, rays: ViewRays, edges: Tensor, looks: ShadowLooks) -> Tensor:
    """The same for a lamp, as a share of the angle."""
    position, radius = point.light.position, point.light.radius

    def place(angles: Tensor, some: ViewRays) -> Tensor:
        return distances_at_angles(some, angles, position, radius).to(some.origin.dtype)

    return _lit_share(point.visibility, rays, angles_at_lamp(rays, edges, position, radius), looks, place)


def _halve(visibility: Visibility, rays: ViewRays, first: Tensor, last: Tensor, halvings: int, place: Place) -> Tensor:
    """Lit share `(ray,)` of stretches of rays that are lit at one end only."""

    def look(share: Tensor) -> Tensor:
        return visibility.look_up_lit(rays.points_at(place((first + share * (last - first))[:, None], rays)))[:, 0]

    low, high = torch.zeros_like(first), torch.ones_like(first)
    starts_lit = look(low)
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        same = look(middle) == starts_lit
        low, high = torch.where(same, middle, low), torch.where(same, high, middle)
    border = 0.5 * (low + high)
    return torch.where(starts_lit, border, 1.0 - border)


def accumulate_sunlight(air: Air, sun: SunInScene, rays: ViewRays, edges: Tensor) -> Tensor:
    """Sunlight that rays gather up to each border if nothing stands in its way: smooth, and exact at the borders for one medium.

    Args:
        air: what scatters.
        sun: its visibility is not asked for.
        rays: where to.
        edges: borders of the steps `(ray, step + 1)` [m].

    Returns:
        Light `(ray, step + 1, channel)`, 0 at the first border.
    """
    height = rays.origin[:, 2:] + rays.direction[:, 2:] * edges
    lengths = edges.diff(dim=1)
    cosine = (rays.direction @ rays.direction.new_tensor(sun.light.direction)).clamp(-1.0, 1.0)
    depth = edges.new_zeros(*lengths.shape, 3)
    scattered = torch.zeros_like(depth)
    for part, step in zip(air.particles, _measure_steps(air, rays, edges, height, lengths), strict=True):
        depth = depth + step
        scattered = scattered + part.albedo * part.evaluate_phase(cosine)[:, None, None] * step
    exponent = torch.nn.functional.pad(depth.cumsum(dim=1), (0, 0, 1, 0)) + sun.depth.look_up(height)
    arriving = exponential_mean(exponent[:, :-1], exponent[:, 1:])
    arriving = arriving * _bank_transmittance(air, sun.shades, rays, edges)
    light = scattered * arriving * depth.new_tensor(sun.light.irradiance)
    return torch.nn.functional.pad(light.cumsum(dim=1), (0, 0, 1, 0))
