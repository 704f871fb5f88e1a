"""How the benchmark of shafts measures: a truth of all pixels or of tiles of them, errors against it, and seconds taken in turns."""

import itertools
import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import kornia
import torch
from torch import Tensor

from benchmarks.common import spread
from render.colour import linear_to_srgb
from render.random_streams import child_generator
from render.shafts.methods import METHODS, Method
from render.shafts.scene_file import load_scene
from render.shafts.stage import MapSettings, Stage, prepare_stage
from render.shafts.truth import compute_truth, measure_error

MOST_RAYS, MOST_LAMP_RAYS = 2_500_000, 1_200_000
"""Pixels, or pixels times lamps, whose truth is marched whole; beyond, that of tiles. Lamps need more and dearer steps."""

TILE, TILES_ACROSS, LEAST_SIDE = (90, 160), 8, 11
"""Rows and columns of a tile [pixel], tiles along each side of the image, and the side below which no tile goes."""

SLOW = 20.0
"""Seconds of a run that is not repeated."""

MAPS, QUICK_MAPS = MapSettings(2048, 256), MapSettings(128, 32)


def warm_up() -> None:
    """Let every method run once on a small picture, under the sun and by a lamp: compiled loops are loaded at their first call."""
    window, lights = load_scene("window").resized(200, 112), load_scene("lights").resized(200, 112)
    for scene in (window, replace(lights, lights=lights.lights[:1])):
        stage = prepare_stage(scene, QUICK_MAPS)
        for method in METHODS.values():
            method.gather(stage)


@dataclass(frozen=True, eq=False)
class Reference:
    """The true light of some pixels.

    Args:
        pixels: their numbers `(pixel,)`.
        shape: they are so many pictures of so many rows and columns.
        light: `(pixel, channel)`.
        steps: along the rays that needed most.
    """

    pixels: Tensor
    shape: tuple[int, int, int]
    light: Tensor
    steps: int


def compute_reference(stage: Stage, change: float, whole: bool = False) -> Reference:
    """The truth of all pixels, or of tiles at random where it would take too long and is not asked for."""
    height, width = stage.depth_buffer.shape
    number = torch.arange(height * width).reshape(height, width)
    lamps = len(stage.lighting.points)
    most = MOST_LAMP_RAYS // lamps if lamps else MOST_RAYS
    if whole or height * width <= most:
        pictures = number[None]
    else:
        pictures = torch.stack([number[rows, columns] for rows, columns in _lay_tiles(height, width, most)])
    pixels = pictures.flatten()
    truth = compute_truth(stage.with_rays(pixels), change)
    count, rows, columns = pictures.shape
    return Reference(pixels, (count, rows, columns), truth.in_scattering, truth.steps)


def _lay_tiles(height: int, width: int, most: int) -> Iterator[tuple[slice, slice]]:
    """Rows and columns of tiles of so many pixels in all, one at random within each cell of a grid: every part may be hit."""
    scale = min(1.0, math.sqrt(most / (TILES_ACROSS**2 * math.prod(TILE))))
    sizes = [
        (whole / TILES_ACROSS, min(max(LEAST_SIDE, int(scale * side)), whole // TILES_ACROSS))
        for side, whole in zip(TILE, (height, width), strict=True)
    ]
    generator = child_generator(0)
    for cell in itertools.product(range(TILES_ACROSS), repeat=2):
        luck = torch.rand(2, generator=generator).tolist()
        starts = [
            int(number * room + share * (room - side))
            for number, share, (room, side) in zip(cell, luck, sizes, strict=True)
        ]
        rows, columns = (slice(start, start + side) for start, (_, side) in zip(starts, sizes, strict=True))
        yield rows, columns


def judge(light: Tensor, reference: Reference) -> dict[str, float]:
    """Errors of the light of all pixels `(pixel, channel)`.

    The similarity (SSIM, windows of 11 pixels) is that of display values, the brightest true light being white.
    """
    found = light[reference.pixels]
    error = measure_error(found, reference.light)
    white = float(reference.light.max()) or 1.0
    shown = [
        linear_to_srgb((values / white).clamp(0.0, 1.0)).reshape(*reference.shape, 3).permute(0, 3, 1, 2)
        for values in (found, reference.light)
    ]
    similarity = float(kornia.metrics.ssim(shown[0], shown[1], 11).mean())
    return {"relative_rms": error.relative_rms, "largest": error.largest, "ssim": similarity}


def clocked(method: Method, stage: Stage) -> tuple[float, Tensor]:
    """Seconds and light of one run."""
    begun = time.perf_counter()
    light = method.gather(stage).in_scattering
    return time.perf_counter() - begun, light


def compare(
    methods: Mapping[str, Method], stage: Stage, reference: Reference, repeats: int, base: str | None = None
) -> dict[str, dict[str, Any]]:
    """Seconds, taken in turns, and errors of methods; how much faster than the one called `base` each is, if one is."""
    seconds: dict[str, list[float]] = {key: [] for key in methods}
    errors: dict[str, dict[str, float]] = {}
    for number in range(repeats):
        for key, method in methods.items():
            if number and seconds[key][0] > SLOW:
                continue
            spent, light = clocked(method, stage)
            seconds[key].append(spent)
            errors[key] = judge(light, reference)
    found: dict[str, dict[str, Any]] = {key: {"seconds": spread(seconds[key]), **errors[key]} for key in methods}
    if base is not None:
        for one in found.values():
            one["speed_up"] = found[base]["seconds"]["median"] / one["seconds"]["median"]
    return found


def error_cells(found: Mapping[str, Any]) -> tuple[str, str, str]:
    """The three errors for a table."""
    return f"{found['relative_rms']:.2%}", f"{found['largest']:.2%}", f"{found['ssim']:.4f}"


ERROR_COLUMNS = ("relative RMS", "largest", "SSIM")
