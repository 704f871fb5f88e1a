"""A scene small enough for tests: a ball of cloud, a few pixels, a stack of a few nodes, and a photograph rendered from it."""

import math
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from cloudfit.analysis import PhotographAnalysis
from cloudfit.cloud_mask import CloudMask, Label
from cloudfit.photograph import Photograph
from cloudfit.quality import Quality
from cloudfit.scene import Scene
from cloudfit.stack import prepare_stack
from cloudfit.sunlight import Sunlight
from precompute.error_budget import Effort
from render.camera import frame_volume
from render.density_grid import DensityGrid
from render.scattering_stack import ScatteringStack

TINY = Quality(0.5, Effort(3, 400, 8_000, 4), Effort(3, 800, 8_000, 4), 3, 1.2, math.inf)


def ball(resolution: int = 12) -> DensityGrid:
    """Ball of density one with a soft rim, 100 m across."""
    axis = (torch.arange(resolution) + 0.5) / resolution * 2.0 - 1.0
    z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
    return DensityGrid.from_voxel_size(
        ((1.0 - torch.sqrt(x * x + y * y + z * z)) * 4.0).clamp(0.0, 1.0), 100.0 / resolution
    )


@cache
def small_scene(width: int = 48, height: int = 36) -> Scene:
    """The ball seen from the south, sun in the south-west."""
    grid = ball()
    return Scene(grid, None, frame_volume(grid, width=width, height=height), math.radians(220.0), math.radians(40.0))


@cache
def small_stack() -> ScatteringStack:
    """Stack of the small scene."""
    return prepare_stack(small_scene(), TINY, seed=3)[0]


def made_up_analysis(
    cloud_pixels: Tensor, sky: Tensor, colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> PhotographAnalysis:
    """Analysis of a photograph whose cloud pixels `(pixel, channel)` and sky `(height, width, channel)` are known."""
    height, width, _ = sky.shape
    pixels = sky.clone().reshape(-1, 3)
    pixels[: len(cloud_pixels)] = cloud_pixels
    labels = torch.full((height * width,), int(Label.SKY), dtype=torch.uint8)
    labels[: len(cloud_pixels)] = int(Label.CLOUD)
    photograph = Photograph(
        path=Path("made_up.png"),
        pixels=pixels.reshape(height, width, 3),
        opaque=torch.ones(height, width, dtype=torch.bool),
        original_size=(height, width),
        bit_depth=8,
        exposure=1.0,
        sha256="0" * 64,
    )
    light = torch.tensor(colour)
    return PhotographAnalysis(
        photograph=photograph,
        mask=CloudMask(labels.reshape(height, width)),
        sky=sky,
        sunlight=Sunlight(light, 0.5, 0.5, torch.tensor([0.5, 0.7, 1.0])),
        warnings=(),
    )
