"""Reference images of parameter sets: stacks with one node each and much effort; and how far another stack's images are from them."""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from benchmarks.common import stopwatch
from benchmarks.parameter_sets import KNOWN_WITHIN, Disagreement, ParameterSet, TracedPixels, largest_optical_length
from benchmarks.synthetic_photograph import sky_gradient
from cloudfit.colour_histogram import LEVELS, colour_histogram
from cloudfit.fit_problem import SUNLIGHT_HEADROOM, brightest_radiance, visible_share
from cloudfit.losses import l1_distance, l1_floor, wasserstein_distance
from cloudfit.scene import Scene
from precompute.error_budget import Effort
from precompute.stack_store import load_or_build_stack
from render.cloud_image import Lighting, compose_cloud
from render.colour import srgb_to_linear
from render.scattering_stack import CloudLayers, ScatteringStack

AMBIENT = 0.1

BRIGHT_LEVEL, BRIGHT_SHARE = 0.8, 0.95
"""Display level of the bright cloud pixels, and the share of the pixels that are darker."""


@dataclass(frozen=True)
class Difference:
    """One image against its reference.

    Args:
        error: relative RMS over the pixels of the grey image.
        grey_levels: Wasserstein distance of the display histograms, mean of the channels.
        l1_over_floor: L1 distance of the same histograms over that of two unrelated samples of so many pixels.
    """

    error: float
    grey_levels: float
    l1_over_floor: float


class ReferenceImages:
    """Images of parameter sets from stacks with that one node.

    Args:
        scene: volume, camera of the images, sun.
        sets: of parameters.
        effort: of each image.
        folder: where they are kept.
    """

    def __init__(self, scene: Scene, sets: list[ParameterSet], effort: Effort, folder: Path) -> None:
        self.scene, self.sets, self.effort, self.folder = scene, sets, effort, folder
        self.largest = self.largest_optical_length(scene)
        self.stacks: list[ScatteringStack] = []

    @staticmethod
    def largest_optical_length(scene: Scene) -> float:
        """Of any view ray of the full-size camera [m]."""
        return largest_optical_length(scene.grid, scene.camera)

    def build(self) -> None:
        """Build the images, or find them in the folder."""
        scene = self.scene
        for number, one in enumerate(self.sets):
            node = torch.tensor([one.asymmetry]), torch.tensor([one.optical_depth / self.largest])
            tables, _ = load_or_build_stack(
                self.folder, scene.grid, scene.camera, scene.sun_direction, *node, self.effort, 1000 + number
            )
            self.stacks.append(ScatteringStack(tables))

    def trace(self, pixels: int, paths: int) -> list[Disagreement]:
        """How far the references are from the path tracer."""
        scene = self.scene
        traced = TracedPixels(scene.grid, scene.camera, scene.sun_direction, pixels, paths, self.folder)
        return [
            traced.compare(stack, one, number)
            for number, (stack, one) in enumerate(zip(self.stacks, self.sets, strict=True))
        ]

    def describe(self, truth: list[Disagreement]) -> list[str]:
        """Sentences about the references."""
        paths = sum(int(str(group["paths"])) for stack in self.stacks for group in stack.tables.groups)
        about = f"reference images: {len(self.sets)} stacks of one node, {paths / 1e6:.3g} M paths in all"
        if not truth:
            return [f"{about}; not compared with the path tracer"]
        errors, noise = ([getattr(one, name) for one in truth] for name in ("error", "noise"))
        apart = sum(one.known for one in truth)
        return [
            f"{about}; from the path tracer they are {sorted(errors)[len(errors) // 2]:.2%} apart in the median and {max(errors):.2%} at "
            f"most, the path tracer's own noise of {sorted(noise)[len(noise) // 2]:.2%} subtracted; {apart} of {len(truth)} "
            f"are known within {KNOWN_WITHIN:.0%}"
        ]

    def compare(self, stack: ScatteringStack, bins: int) -> tuple[list[Difference], float]:
        """Differences at all sets, and the milliseconds that a candidate takes, histogram included."""
        differences, milliseconds = [], []
        for one, reference in zip(self.sets, self.stacks, strict=True):
            exact = self._layers(reference, one)
            lighting = _light(reference, exact)
            with stopwatch() as seconds:
                layers = self._layers(stack, one)
                histogram = _histogram(stack, layers, lighting, bins)
            milliseconds.append(1000.0 * seconds[0])
            target = _histogram(reference, exact, lighting, bins)
            floor = l1_floor(target, int(visible_share(stack.optical_length).sum()))
            differences.append(
                Difference(
                    _relative_error(stack, layers, reference, exact),
                    float(wasserstein_distance(histogram, target).mean()) * LEVELS / bins,
                    float(l1_distance(histogram, target).mean() / floor.mean()),
                )
            )
        return differences, sorted(milliseconds)[len(milliseconds) // 2]

    @torch.no_grad()
    def _layers(self, stack: ScatteringStack, one: ParameterSet) -> CloudLayers:
        values = (one.asymmetry, one.optical_depth / self.largest, one.albedo)
        return stack(*(torch.tensor([value]) for value in values))


def _light(reference: ScatteringStack, layers: CloudLayers) -> Lighting:
    """White sunlight that makes the cloud bright, as far as the search of a fit would go."""
    level = float(srgb_to_linear(torch.full((3,), BRIGHT_LEVEL))[0])
    bright = float((layers.single + layers.multiple)[0].quantile(BRIGHT_SHARE))
    strongest = SUNLIGHT_HEADROOM * level / brightest_radiance(reference)
    intensity = min((level - AMBIENT) / max(bright, 1e-30), strongest)
    return Lighting(torch.tensor([intensity]), torch.ones(3), torch.tensor([AMBIENT]), torch.ones(3))


def _histogram(stack: ScatteringStack, layers: CloudLayers, lighting: Lighting, bins: int) -> Tensor:
    """Display histogram `(channel, bin)` of the pixels that count."""
    sky = sky_gradient(stack.tables.width, stack.tables.height).flatten(0, 1)[stack.pixel].T
    picture = compose_cloud(layers, lighting, sky)[0]
    histogram = colour_histogram(picture[:, visible_share(stack.optical_length)].T)
    return merge_bins(histogram, bins)


def merge_bins(histogram: Tensor, bins: int) -> Tensor:
    """Histogram `(..., bin)` with neighbouring bins joined, down to so many."""
    return histogram.unflatten(-1, (bins, -1)).sum(-1)


def _relative_error(
    stack: ScatteringStack, layers: CloudLayers, reference: ScatteringStack, exact: CloudLayers
) -> float:
    image, truth = _spread(stack, layers), _spread(reference, exact)
    factor = truth.shape[1] // image.shape[1]
    truth = avg_pool2d(truth[None], factor)[0] if factor > 1 else truth
    return float(((image - truth).square().mean() / truth.square().mean()).sqrt())


def _spread(stack: ScatteringStack, layers: CloudLayers) -> Tensor:
    """Grey image `(height, width)`, float64."""
    tables = stack.tables
    image = torch.zeros(tables.height * tables.width, dtype=torch.float64)
    image[stack.pixel] = (layers.single + layers.multiple)[0].double()
    return image.unflatten(0, (tables.height, tables.width))
