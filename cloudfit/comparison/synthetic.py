"""Photographs composed from a stack at parameters that are known, so that a search has an answer to be compared with."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from cloudfit.analysis import PhotographAnalysis
from cloudfit.cloud_mask import CloudMask, Label
from cloudfit.fit_problem import visible_share
from cloudfit.fit_types import AIR_STEP
from cloudfit.parameters import SearchSpace
from cloudfit.photograph import Photograph
from cloudfit.sunlight import Sunlight
from render.cloud_image import Lighting, blend_air, compose_cloud
from render.colour import srgb_to_linear
from render.scattering_stack import CloudLayers, ScatteringStack

HORIZON, ZENITH = (0.55, 0.70, 0.86), (0.13, 0.30, 0.66)
"""Linear light of the sky at the bottom and the top of the image."""

SUNLIGHT_COLOUR = (1.0, 0.98, 0.94)

BRIGHT_SHARE = 0.95
"""Share of the cloud pixels that are darker than the bright level."""

ALBEDO, AMBIENT, BRIGHT_LEVEL, AIR_STEPS = (0.8, 1.0), (0.0, 0.3), (0.7, 0.85), 3
"""Ranges of the random truth; the optical depth of the air is a small multiple of the step in which a search tries it first."""


@dataclass(frozen=True, eq=False)
class ComposedTruth:
    """What a composed photograph is made with.

    Args:
        parameters: sunlight_intensity, asymmetry, extinction [1/m], albedo, ambient.
        air_depth: optical depth of the air `(channel,)`.
    """

    parameters: dict[str, float]
    air_depth: Tensor


def draw_truth(stack: ScatteringStack, generator: torch.Generator) -> ComposedTruth:
    """Random parameters inside the stack's nodes, at a place where the stack is accurate enough to be searched.

    The intensity of the sunlight is the one with which the bright clouds have a level between 0.7 and 0.85.
    """

    def uniform(low: float, high: float) -> float:
        return low + (high - low) * float(torch.rand((), generator=generator, dtype=torch.float64))

    tables = stack.tables
    thin, thick = float(tables.extinction[0]), float(tables.extinction[-1])
    while True:
        asymmetry = uniform(float(tables.asymmetry[0]), float(tables.asymmetry[-1]))
        extinction = thin * (thick / thin) ** uniform(0.3, 1.0)
        albedo = uniform(*ALBEDO)
        if bool(stack.is_usable(*(torch.tensor([value]) for value in (asymmetry, extinction, albedo)))[0]):
            break
    ambient, level = uniform(*AMBIENT), uniform(*BRIGHT_LEVEL)
    steps = torch.randint(0, AIR_STEPS, (3,), generator=generator)
    layers = _layers(stack, asymmetry, extinction, albedo)
    bright = float((layers.single + layers.multiple)[0].quantile(BRIGHT_SHARE))
    linear = float(srgb_to_linear(torch.full((3,), level))[0])
    intensity = max(linear - ambient, 0.5 * linear) / max(bright, 1e-9)
    values = (intensity, asymmetry, extinction, albedo, ambient)
    names = ("sunlight_intensity", "asymmetry", "extinction", "albedo", "ambient")
    return ComposedTruth(dict(zip(names, values, strict=True)), AIR_STEP * steps.double())


@torch.no_grad()
def compose_analysis(stack: ScatteringStack, truth: ComposedTruth) -> PhotographAnalysis:
    """Photograph of a cloud before a smooth sky, with the analysis of one who knows mask, sky and sunlight.

    Args:
        stack: of the scene; the photograph has the size of its tables.
        truth: what it is made with.
    """
    tables, values = stack.tables, truth.parameters
    sky = sky_gradient(tables.width, tables.height)
    counted = torch.nonzero(visible_share(stack.optical_length)).flatten()
    pixel = stack.pixel[counted]
    behind = sky.flatten(0, 1)[pixel].T.contiguous()
    layers = _layers(stack, values["asymmetry"], values["extinction"], values["albedo"])
    intensity, ambient = (torch.tensor([values[name]]) for name in ("sunlight_intensity", "ambient"))
    colour = torch.tensor(SUNLIGHT_COLOUR)
    cloud = compose_cloud(layers, Lighting(intensity, colour, ambient, colour), behind)
    seen = blend_air(cloud, behind, truth.air_depth.to(torch.float32)[None])[0]
    pixels = sky.flatten(0, 1).clone()
    pixels[pixel] = seen.T
    labels = torch.full((tables.height * tables.width,), int(Label.SKY), dtype=torch.uint8)
    labels[pixel] = int(Label.CLOUD)
    size = (tables.height, tables.width)
    photograph = Photograph(
        path=Path("composed"),
        pixels=pixels.unflatten(0, size),
        original_size=size,
        bit_depth=32,
        exposure=1.0,
        sha256="",
        opaque=torch.ones(size, dtype=torch.bool),
    )
    mask = CloudMask(labels.unflatten(0, size), "user")
    mean_sky = sky.mean((0, 1))
    return PhotographAnalysis(photograph, mask, sky, Sunlight(colour, 0.0, 0.5, mean_sky / mean_sky.max()), ())


def true_point(space: SearchSpace, parameters: Mapping[str, float]) -> Tensor | None:
    """Point of the unit cube `(parameter,)`; None where more is searched than the truth says, such as a free ambient colour."""
    if set(space.names) != set(parameters):
        return None
    physical = torch.tensor([[parameters[name] for name in space.names]])
    return space.to_unit(physical)[0].clamp(0.0, 1.0)


def sky_gradient(width: int, height: int) -> Tensor:
    """Smooth blue sky `(height, width, channel)`, linear light."""
    rise = ((torch.arange(height, dtype=torch.float32) + 0.5) / height)[:, None, None]
    return (torch.tensor(ZENITH) * (1.0 - rise) + torch.tensor(HORIZON) * rise).expand(height, width, 3).contiguous()


def _layers(stack: ScatteringStack, asymmetry: float, extinction: float, albedo: float) -> CloudLayers:
    with torch.no_grad():
        layers = stack(*(torch.tensor([value]) for value in (asymmetry, extinction, albedo)))
    counted = torch.nonzero(visible_share(stack.optical_length)).flatten()
    return CloudLayers(
        layers.single[:, counted],
        layers.multiple[:, counted],
        layers.transmittance[:, counted],
        layers.opacity[:, counted],
    )
