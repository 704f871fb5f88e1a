"""Light of a whole frame from rays along epipolar lines, one set of lines for each light."""

from collections.abc import Callable

import torch
from torch import Tensor

from render.shafts.epipolar import LightImage
from render.shafts.epipolar_sampling import EpipolarSampling, EpipolarSettings, build_epipolar_sampling
from render.shafts.lights import Lighting
from render.shafts.rays import ViewRays
from render.shafts.stage import Clock, Stage

BLOCKED = 0.9
"""Share of a ray's length before which a surface means that the ray passes beside what its pixel sees."""

MOST_RAYS = 4.0
"""Rays for each pixel beyond which lines are given up. Small pictures, on which settings are chosen, have up to three with the usual
settings: without lines their error would say nothing of the interpolation in a large picture."""

LineMarcher = Callable[[Lighting, ViewRays, Tensor | None], Tensor]
"""One light, rays, and the numbers of their epipolar lines `(ray,)` (None for rays of no line) to light `(ray, channel)`.

Where lines would need `MOST_RAYS` times as many rays as there are pixels, each pixel's ray is a line of its own.
"""


def find_light_image(stage: Stage, lighting: Lighting) -> LightImage | None:
    """Image of the one light of a lighting; None where all its lines would be points, for a sun in line with parallel rays."""
    camera = stage.scene.camera
    if lighting.sun is not None:
        x, y, w = camera.project(lighting.sun.light.direction, at_infinity=True)
    else:
        x, y, w = camera.project(lighting.points[0].light.position)
    if x == y == w == 0.0:
        return None
    return LightImage(x, y, w, camera.width, camera.height)


def gather_along_lines(
    stage: Stage, lights: Lighting, settings: EpipolarSettings, marcher: LineMarcher, clock: Clock
) -> Tensor:
    """Light of all pixels `(pixel, channel)`: lights one by one, each with its lines.

    Args:
        stage: the scene.
        lights: those to gather.
        settings: how densely lines and samples lie.
        marcher: gathers the light of rays.
        clock: takes the seconds of each part.

    Returns:
        The sum over the lights.
    """
    total = torch.zeros_like(stage.background)
    for lighting in lights.separate():
        image = find_light_image(stage, lighting)
        if image is None:
            total += marcher(lighting, stage.rays, None)
            continue
        with clock.timed("epipolar lines"):
            sampling = build_epipolar_sampling(image, stage.depth_buffer, settings)
            needless = len(sampling.marched) + len(sampling.own_pixels) > MOST_RAYS * len(stage.rays)
            on_lines = _cast_samples(stage, sampling) if not needless else None
        if on_lines is None:
            with clock.timed("marching"):
                # Lines so dense cost more than what they approximate.
                total += marcher(lighting, stage.rays, torch.arange(len(stage.rays)))
            continue
        with clock.timed("marching"):
            marched = marcher(lighting, on_lines, sampling.line[sampling.marched])
            own = marcher(lighting, stage.rays[sampling.own_pixels], None)
        with clock.timed("interpolation"):
            total += sampling.interpolate(marched, own)
    return total


def _cast_samples(stage: Stage, sampling: EpipolarSampling) -> ViewRays:
    """Rays of the samples to march, as long as that of the pixel under each; where a surface is in the way, that pixel's own ray."""
    points, depth = sampling.points[sampling.marched], sampling.depth[sampling.marched]
    rays = stage.rays_through(points, depth)
    blocked = torch.nonzero(stage.caster.find_occluded(rays.origin, rays.direction, BLOCKED * depth))[:, 0]
    camera = stage.scene.camera
    most = points.new_tensor([camera.width - 1, camera.height - 1])
    pixel = torch.minimum(points[blocked].floor().clamp(min=0.0), most)
    number = (pixel[:, 1] * camera.width + pixel[:, 0]).long()
    direction = rays.direction.index_copy(0, blocked, stage.rays.direction[number])
    return ViewRays(rays.origin.index_copy(0, blocked, stage.rays.origin[number]), direction, depth)


def describe(sampling_settings: EpipolarSettings) -> str:
    """The density of lines and samples in words."""
    return (
        f"epipolar lines at most {sampling_settings.line_gap:g} pixels apart, every {sampling_settings.stride}th sample "
        "marched, and those at edges of depth"
    )


__all__ = ["EpipolarSampling", "LineMarcher", "describe", "find_light_image", "gather_along_lines"]
