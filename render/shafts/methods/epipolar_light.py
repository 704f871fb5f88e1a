"""Light of a whole frame from rays along epipolar lines, one set of lines for each light."""

from collections.abc import Callable

import torch
from torch import Tensor

from render.shafts.epipolar import LightImage
from render.shafts.epipolar_sampling import EpipolarSampling, EpipolarSettings, build_epipolar_sampling
from render.shafts.lights import Lighting
from render.shafts.rays import ViewRays
from render.shafts.stage import Clock, Stage

LineMarcher = Callable[[Lighting, ViewRays, Tensor | None], Tensor]
"""One light, rays, and the numbers of their epipolar lines `(ray,)` (None for rays of no line) to light `(ray, channel)`."""


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


def gather_along_lines(stage: Stage, settings: EpipolarSettings, marcher: LineMarcher, clock: Clock) -> Tensor:
    """Light of all pixels `(pixel, channel)`: lights one by one, each with its lines.

    Args:
        stage: the scene.
        settings: how densely lines and samples lie.
        marcher: gathers the light of rays.
        clock: takes the seconds of each part.

    Returns:
        The sum over the lights.
    """
    total = torch.zeros_like(stage.background)
    for lighting in stage.lighting.separate():
        image = find_light_image(stage, lighting)
        if image is None:
            total += marcher(lighting, stage.rays, None)
            continue
        with clock.timed("epipolar lines"):
            sampling = build_epipolar_sampling(image, stage.depth_buffer, settings)
            on_lines = _cast_samples(stage, sampling)
        with clock.timed("marching"):
            marched = marcher(lighting, on_lines, sampling.line[sampling.marched])
            own = marcher(lighting, stage.rays[sampling.own_pixels], None)
        with clock.timed("interpolation"):
            total += sampling.interpolate(marched, own)
    return total


def _cast_samples(stage: Stage, sampling: EpipolarSampling) -> ViewRays:
    """Rays of the samples to march: no farther than the pixel under them sees, nor through a surface beside its centre."""
    rays = stage.rays_through(sampling.points[sampling.marched], sampling.depth[sampling.marched])
    surface = stage.caster.find_distance(rays.origin, rays.direction)
    return ViewRays(rays.origin, rays.direction, torch.minimum(rays.distance, surface))


def describe(sampling_settings: EpipolarSettings) -> str:
    """The density of lines and samples in words."""
    return (
        f"epipolar lines at most {sampling_settings.line_gap:g} pixels apart, every {sampling_settings.stride}th sample "
        "marched, and those at edges of depth"
    )


__all__ = ["EpipolarSampling", "LineMarcher", "describe", "find_light_image", "gather_along_lines"]
