"""Random parameter sets of what a fit may search, the table that covers them, and path-traced pixels to compare with."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
from torch import Tensor

from cloudfit.quality import Quality
from precompute.store import table_key
from render.camera import Camera
from render.density_grid import DensityGrid
from render.path_tracer import trace_reference
from render.ray_march import compute_optical_length
from render.scattering_stack import ScatteringStack

ASYMMETRY, DEPTH, ALBEDO = (0.0, 0.9), (0.05, 60.0), (0.8, 1.0)
"""Ranges; the depth is the largest optical depth of a view ray."""

REFERENCE_ORDERS = 256

SETS_SEED, PIXELS_SEED, REFERENCE_SEED = 7, 11, 100

SEEDS_A_ROUND = 1000

THIN_DEPTH, LONGER = 2.0, 4
"""Largest optical depth below which references may take so many times the rounds: paths in thin clouds are cheap, and few scatter."""

KNOWN_WITHIN = 0.2
"""Deviation over an error up to which it counts as known."""


@dataclass(frozen=True)
class ParameterSet:
    """What an image depends on, beside volume, camera and sun."""

    asymmetry: float
    optical_depth: float
    albedo: float

    def at_node(self, asymmetry: Tensor, optical_depth: Tensor) -> "ParameterSet":
        """The same at the node of a table that is next to it, of depths in their logarithm."""
        row = int((asymmetry - self.asymmetry).abs().argmin())
        column = int((optical_depth.log() - math.log(self.optical_depth)).abs().argmin())
        return replace(self, asymmetry=float(asymmetry[row]), optical_depth=float(optical_depth[column]))


def draw_sets(count: int, seed: int = SETS_SEED) -> list[ParameterSet]:
    """Random sets: asymmetry and albedo uniform, optical depth uniform in its logarithm."""
    generator = torch.Generator().manual_seed(seed)
    return [_place(values) for values in torch.rand(count, 3, generator=generator, dtype=torch.float64).tolist()]


def _place(uniform: list[float]) -> ParameterSet:
    asymmetry = ASYMMETRY[0] + (ASYMMETRY[1] - ASYMMETRY[0]) * uniform[0]
    depth = DEPTH[0] * (DEPTH[1] / DEPTH[0]) ** uniform[1]
    return ParameterSet(asymmetry, depth, ALBEDO[0] + (ALBEDO[1] - ALBEDO[0]) * uniform[2])


def table_nodes(quality: Quality, largest_optical_length: float) -> tuple[Tensor, Tensor]:
    """Asymmetry and extinction nodes that cover the ranges."""
    extinction = (quality.place_depths(*DEPTH) / largest_optical_length).float()
    return torch.linspace(*ASYMMETRY, quality.asymmetry_nodes), extinction


def largest_optical_length(grid: DensityGrid, camera: Camera) -> float:
    """Of any view ray [m]."""
    return float(compute_optical_length(grid, *camera.rays()).max())


def grey_image(stack: ScatteringStack, one: ParameterSet, largest_optical_length: float) -> Tensor:
    """Scattered light of the stack's cloud pixels for unit sunlight `(pixel,)`."""
    values = (one.asymmetry, one.optical_depth / largest_optical_length, one.albedo)
    with torch.no_grad():
        layers = stack(*(torch.tensor([value]) for value in values))
    return (layers.single + layers.multiple)[0]


@dataclass(frozen=True, eq=False)
class Disagreement:
    """An image against a path-traced one.

    Args:
        error: relative RMS over the pixels, the noise of the reference subtracted in quadrature.
        bias: of the mean over the pixels, relative.
        noise: of the reference, relative RMS.
        deviation: of the error, from the spread of squared differences over the pixels, which holds the noise of the reference as well
            as the chance of which pixels were traced.
    """

    error: float
    bias: float
    noise: float
    deviation: float

    @property
    def known(self) -> bool:
        """Whether the error is known well enough to be compared with."""
        return self.deviation <= KNOWN_WITHIN * self.error

    @property
    def at_least(self) -> float:
        """The error, but no less than can be told apart from the reference's noise."""
        return max(self.error, self.noise / 4.0)


@dataclass(frozen=True, eq=False)
class TracedPixels:
    """Some of the cloud pixels, traced for long by the reference path tracer, and kept in a folder.

    Args:
        grid, camera, sun: the scene.
        pixels: how many.
        paths: of one round over all pixels.
        folder: of the references, or None.
        noise: relative RMS at which no further round is traced.
        rounds: at most, but see `THIN_DEPTH`.
    """

    grid: DensityGrid
    camera: Camera
    sun: Tensor
    pixels: int
    paths: int
    folder: Path | None
    noise: float = 1000.0
    rounds: int = 1

    def compare(self, stack: ScatteringStack, one: ParameterSet, number: int) -> Disagreement:
        """The stack's image against the reference; `number` tells the random streams of the sets apart."""
        pixels, radiance, variance = self._trace(one, number)
        image = grey_image(stack, one, largest_optical_length(self.grid, self.camera))
        image = image[torch.searchsorted(stack.pixel, pixels)].double()
        power, difference = radiance.square().mean(), image - radiance
        squares = (difference.square() - variance) / power
        error = float(squares.mean().clamp(min=0.0).sqrt())
        of_square = float(squares.std() / math.sqrt(len(squares)))
        return Disagreement(
            error,
            float(difference.mean() / radiance.mean()),
            float((variance.mean() / power).sqrt()),
            of_square / (2.0 * error) if error > 0.0 else math.sqrt(of_square),
        )

    def _trace(self, one: ParameterSet, number: int) -> tuple[Tensor, Tensor, Tensor]:
        """Pixels, their radiance and its variance, traced now or found in the folder."""
        optical_length = compute_optical_length(self.grid, *self.camera.rays())
        seen = torch.nonzero(optical_length > 0).flatten()
        shuffled = torch.randperm(len(seen), generator=torch.Generator().manual_seed(PIXELS_SEED))
        pixels = seen[shuffled[: self.pixels]].sort().values
        samples = max(2, self.paths // len(pixels))
        rounds = self.rounds * (LONGER if one.optical_depth < THIN_DEPTH else 1)
        question = {
            "grid": self.grid.density,
            "camera": self.camera,
            "sun": self.sun,
            "pixels": pixels,
            "values": (one.asymmetry, one.optical_depth, one.albedo, samples, number, self.noise, rounds),
        }
        file = None if self.folder is None else self.folder / f"reference-{table_key(question)[:16]}.npz"
        if file is not None and file.exists():
            kept = np.load(file)
            return pixels, torch.from_numpy(kept["radiance"]), torch.from_numpy(kept["variance"])
        means, variances = [], []
        for turn in range(rounds):
            image = trace_reference(
                self.grid,
                self.camera,
                self.sun,
                extinction=one.optical_depth / float(optical_length.max()),
                asymmetry=one.asymmetry,
                albedo=one.albedo,
                orders=REFERENCE_ORDERS,
                recorded=1,
                samples=samples,
                seed=REFERENCE_SEED + number + SEEDS_A_ROUND * turn,
                pixels=pixels,
            )
            means.append(image.radiance[pixels].double())
            variances.append(image.radiance_variance[pixels].double())
            radiance = torch.stack(means).mean(0)
            variance = torch.stack(variances).mean(0) / len(means)
            if float((variance.mean() / radiance.square().mean()).sqrt()) <= self.noise:
                break
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            np.savez(file, radiance=radiance.numpy(), variance=variance.numpy())
        return pixels, radiance, variance


Constant = tuple[ModuleType | type, str, object]
"""A module or class, the name of a constant or function in it, and another value."""


@contextmanager
def varied(constants: tuple[Constant, ...]) -> Iterator[None]:
    """Within this block constants have other values."""
    before = [(module, name, getattr(module, name)) for module, name, _ in constants]
    try:
        for module, name, value in constants:
            setattr(module, name, value)
        yield
    finally:
        for module, name, value in before:
            setattr(module, name, value)
