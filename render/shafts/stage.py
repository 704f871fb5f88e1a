"""A scene made ready for marching: depth buffer, what is seen without air, shadow maps, and the table of depths to the sun."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from render.errors import ParameterError
from render.gradient_sky import look_up_gradient_sky
from render.shafts.cube_shadow_map import build_cube_shadow_map
from render.shafts.fog_bank import build_shades, look_up_shade
from render.shafts.lights import (
    AlwaysLit,
    Lighting,
    PointInScene,
    PointLight,
    Sun,
    SunInScene,
    Visibility,
    build_sun_depth,
)
from render.shafts.ray_casting import Hits, PointRays, RayCaster, SunRays
from render.shafts.rays import ViewRays
from render.shafts.scene import ShaftScene
from render.shafts.self_shadowing import DistantLight, NearLight
from render.shafts.shadow_map import build_shadow_map
from render.shafts.soft_lights import split_lamp, split_sun

LIFT = 1e-4
"""Share of a ray's length by which a shadow ray begins before the surface; float32 does not place the surface better."""


@dataclass(frozen=True)
class MapSettings:
    """How shadows are found.

    Args:
        sun_resolution: texels along the longer side of the sun's map.
        lamp_resolution: texels along an edge of the cube around each point light.
        exact: cast a ray for each point instead.

    Raises:
        ParameterError: for a resolution below 1.
    """

    sun_resolution: int = 1024
    lamp_resolution: int = 256
    exact: bool = False

    def __post_init__(self) -> None:
        if min(self.sun_resolution, self.lamp_resolution) < 1:
            raise ParameterError(f"expected shadow maps of at least one texel, got {self}")


@dataclass
class Clock:
    """Seconds of each part of the work, in order of first mention."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """Add the time of this block to a part."""
        begun = time.perf_counter()
        yield
        self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - begun


@dataclass(frozen=True, eq=False)
class Stage:
    """A scene made ready; what every method starts from.

    Args:
        scene: as stated.
        rays: one a pixel, to the first surface or the reach of the scene.
        background: what is seen without air `(pixel, channel)`.
        lighting: the lights with their shadows.
        caster: meshes prepared for ray casting.
        seconds: what preparing each part took [s].
    """

    scene: ShaftScene
    rays: ViewRays
    background: Tensor
    lighting: Lighting
    caster: RayCaster
    seconds: dict[str, float]

    @property
    def depth_buffer(self) -> Tensor:
        """Lengths of the rays `(height, width)` [m]."""
        return self.rays.distance.reshape(self.scene.camera.height, self.scene.camera.width)

    def with_rays(self, chosen: Tensor) -> "Stage":
        """The same scene and lights with some of the rays `(ray,)`: no picture any more, but enough for a march ray by ray."""
        return replace(self, rays=self.rays[chosen], background=self.background[chosen])

    def rays_through(self, points: Tensor, distance: Tensor) -> ViewRays:
        """Rays of given lengths `(point,)` [m] through points of the image `(point, 2)`: x, y [pixel]."""
        return ViewRays(*self.scene.camera.rays_through(points), distance)


def prepare_stage(scene: ShaftScene, maps: MapSettings | None = None) -> Stage:
    """Make a scene ready.

    Args:
        scene: what is to be rendered.
        maps: how shadows are found; None for maps of the usual sizes.

    Returns:
        The stage, float32.

    Raises:
        MissingExtraError: the scene has meshes, and embreex is not installed.
    """
    settings, clock = maps or MapSettings(), Clock()
    with clock.timed("geometry"):
        caster = RayCaster(scene.meshes)
    with clock.timed("depth buffer"):
        origin, direction = scene.camera.rays()
        hits = caster.find_surface(origin, direction)
        rays = ViewRays(origin, direction, hits.distance.clamp(max=scene.reach))
    with clock.timed("shadow maps"):
        lighting = _light_scene(scene, caster, rays, settings)
    with clock.timed("surfaces"):
        background = _shade(scene, caster, rays, hits, lighting)
    return Stage(scene, rays, background, lighting, caster, clock.seconds)


def relight(stage: Stage, maps: MapSettings) -> Stage:
    """The same stage with shadows found another way."""
    return replace(stage, lighting=_light_scene(stage.scene, stage.caster, stage.rays, maps))


def _light_scene(scene: ShaftScene, caster: RayCaster, rays: ViewRays, maps: MapSettings) -> Lighting:
    ends = rays.origin[:, 2] + rays.direction[:, 2] * rays.distance
    lowest = float(torch.minimum(ends, rays.origin[:, 2]).min())
    highest = float(torch.maximum(ends, rays.origin[:, 2]).max())
    suns = []
    if scene.sun is not None and any(scene.sun.irradiance):
        for sun in split_sun(scene.sun):
            table = build_sun_depth(scene.air, sun, lowest, highest)
            shades = build_shades(scene.air.banks, DistantLight(sun.direction))
            suns.append(SunInScene(sun, table, _sun_visibility(sun, caster, rays, maps), shades))
    shining = [point for light in scene.lights if any(light.intensity) for point in split_lamp(light)]
    points = tuple(_place_lamp(scene, light, caster, maps) for light in shining)
    return Lighting(suns[0] if suns else None, points, tuple(suns[1:]))


def _place_lamp(scene: ShaftScene, light: PointLight, caster: RayCaster, maps: MapSettings) -> PointInScene:
    shades = build_shades(scene.air.banks, NearLight(light.position))
    return PointInScene(light, _lamp_visibility(light, caster, maps), shades)


def _sun_visibility(sun: Sun, caster: RayCaster, rays: ViewRays, maps: MapSettings) -> Visibility:
    if caster.empty:
        return AlwaysLit()
    if maps.exact:
        return SunRays(caster, sun.direction)
    ends = torch.cat([rays.origin, rays.origin + rays.distance[:, None] * rays.direction])
    return build_shadow_map(caster, sun.direction, maps.sun_resolution, ends)


def _lamp_visibility(light: PointLight, caster: RayCaster, maps: MapSettings) -> Visibility:
    if caster.empty:
        return AlwaysLit()
    if maps.exact:
        return PointRays(caster, light.position)
    return build_cube_shadow_map(caster, light.position, maps.lamp_resolution)


def _shade(scene: ShaftScene, caster: RayCaster, rays: ViewRays, hits: Hits, lighting: Lighting) -> Tensor:
    """What is seen without air in front: diffuse surfaces, lit through the air, and the sky."""
    seen = torch.isfinite(hits.distance) & (hits.distance <= scene.reach)
    radiance = _sky(scene, rays.direction)
    if not bool(seen.any()):
        return radiance
    part, normal = rays[seen], hits.normal[seen]
    points = part.origin + ((1.0 - LIFT) * part.distance)[:, None] * part.direction
    incoming = math.pi * normal.new_tensor(scene.ambient) * (0.5 + 0.5 * normal[:, 2:])
    for sun in lighting.suns:
        incoming = incoming + _sun_on_surfaces(scene, caster, sun, points, normal)
    for point in lighting.points:
        incoming = incoming + _lamp_on_surfaces(scene, caster, point, points, normal)
    radiance[seen] = hits.albedo[seen] / math.pi * incoming
    return radiance


def _sky(scene: ShaftScene, direction: Tensor) -> Tensor:
    if scene.sky is not None:
        return direction.new_tensor(scene.sky).expand_as(direction).clone()
    if scene.sun is None:
        return torch.zeros_like(direction)
    white = direction.new_tensor(scene.sun.irradiance) / math.pi
    return look_up_gradient_sky(direction, direction.new_tensor(scene.sun.direction), white)


def _sun_on_surfaces(
    scene: ShaftScene, caster: RayCaster, shining: SunInScene, points: Tensor, normal: Tensor
) -> Tensor:
    """Irradiance of surfaces by the sun `(point, channel)`."""
    sun = shining.light
    facing = (normal @ normal.new_tensor(sun.direction)).clamp(min=0.0)
    lit = SunRays(caster, sun.direction).look_up_lit(points)
    between = sun.compute_depth(scene.air, points[:, 2]) + look_up_shade(scene.air.banks, shining.shades, points)
    arriving = torch.exp(-between)
    return torch.where(lit, facing, 0.0)[:, None] * arriving * normal.new_tensor(sun.irradiance)


def _lamp_on_surfaces(
    scene: ShaftScene, caster: RayCaster, point: PointInScene, points: Tensor, normal: Tensor
) -> Tensor:
    """Irradiance of surfaces by a point light `(point, channel)`."""
    light = point.light
    towards = normal.new_tensor(light.position) - points
    distance = torch.linalg.vector_norm(towards, dim=-1)
    unit = towards / torch.where(distance > 0.0, distance, 1.0)[:, None]
    facing = (normal * unit).sum(-1).clamp(min=0.0) * light.window(distance) / (distance.square() + light.radius**2)
    lit = PointRays(caster, light.position).look_up_lit(points)
    layers = scene.air.compute_depth(points[:, 2], unit[:, 2].clamp(-1.0, 1.0), distance)
    arriving = torch.exp(-(layers + look_up_shade(scene.air.banks, point.shades, points)))
    return torch.where(lit, facing, 0.0)[:, None] * arriving * normal.new_tensor(light.intensity)
