"""The objective: the only place that knows both the scattering stack and the photograph.

    O = mean over channels of min over kappa of sum over 256 levels |h_image - h_photo|        (Dobashi et al. 2012, equation 2)

The air's optical depth enters each channel alone, so its linear search is 11 x 3 histograms a candidate, not 11^3. Around the
best of the 11 it goes on in finer steps.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import torch
from torch import Tensor

from cloudfit.analysis import PhotographAnalysis
from cloudfit.colour_histogram import colour_histogram, haze_histograms
from cloudfit.fit_types import AIR_DEPTHS, AIR_REFINEMENTS, AIR_STEP
from cloudfit.losses import LOSSES, l1_floor
from cloudfit.parameters import Ambient, SearchSpace, cloud_search_space
from render.cloud_image import Lighting, compose_cloud
from render.phase_functions import evaluate_phase_function
from render.scattering_stack import CloudLayers, ScatteringStack

FAINTEST_SHARE = 0.02
"""Pixels whose optical length is a smaller share of the largest are fringes that no mask would call cloud."""

SUNLIGHT_HEADROOM = 2.0
"""Brightest reachable grey over the photograph's: room for an albedo below one and for air in front."""

DARKEST_ALBEDO = 0.8
"""Of clouds that shall reach the photograph's brightest grey; for those that absorb more, no sunlight is looked for."""

SUNLIGHT_SPAN = 1000.0
"""Strongest over weakest sunlight that is searched."""

AIR_SUBDIVISION = 3
"""A third of a step on either side of the best leaves equal steps between the depths that have been tried."""

POPULATION_CHUNK = 32
"""Candidates composed at once; bounds the memory."""


@dataclass(frozen=True, eq=False)
class HazeSearch:
    """Outcome of the linear search over the air.

    Args:
        loss: smallest L1 loss `(population, channel)`.
        air_depth: where it is reached `(population, channel)`.
        histogram: of the image with that air `(population, channel, bin)`.
    """

    loss: Tensor
    air_depth: Tensor
    histogram: Tensor


def search_haze(cloud: Tensor, sky: Tensor, target: Tensor, display_curve: str, refinements: int) -> HazeSearch:
    """Best optical depth of the air for each candidate and channel, from coarse to fine.

    First the 11 depths of the paper; then each refinement cuts the step to a third and tries the best depth so far plus and minus a
    step. Every candidate is searched by itself, so its loss does not depend on its company.

    Args:
        cloud: radiance `(population, channel, pixel)`.
        sky: radiance behind it `(channel, pixel)`.
        target: the photograph's histogram `(channel, bin)`.
        display_curve: "srgb" or "none".
        refinements: how often; 0 is the search of the paper.
    """
    coarse = torch.tensor(AIR_DEPTHS, dtype=torch.float64)[:, None].expand(len(cloud), -1, len(sky))
    found = _try_depths(cloud, sky, target, display_curve, coarse)
    for refinement in range(1, refinements + 1):
        step = AIR_STEP / AIR_SUBDIVISION**refinement
        beside = torch.stack([found.air_depth - step, found.air_depth + step], dim=1)
        within = beside.clamp(AIR_DEPTHS[0], AIR_DEPTHS[-1])
        found = _better_of(found, _try_depths(cloud, sky, target, display_curve, within))
    return found


def _try_depths(cloud: Tensor, sky: Tensor, target: Tensor, display_curve: str, depths: Tensor) -> HazeSearch:
    """The best of the given depths `(population, kappa, channel)`."""
    histograms = haze_histograms(cloud, sky, torch.exp(-depths), display_curve)
    losses = LOSSES["l1"](histograms, target)
    best = losses.nan_to_num(nan=torch.inf).argmin(1)
    population, channel = torch.meshgrid(torch.arange(len(cloud)), torch.arange(len(sky)), indexing="ij")
    place = (population, best, channel)
    return HazeSearch(losses[place], depths[place], histograms[place])


def _better_of(first: HazeSearch, second: HazeSearch) -> HazeSearch:
    """The smaller loss of two searches for each candidate and channel; the first where they are equal or not numbers."""
    wins = second.loss < first.loss
    return HazeSearch(
        torch.where(wins, second.loss, first.loss),
        torch.where(wins, second.air_depth, first.air_depth),
        torch.where(wins[..., None], second.histogram, first.histogram),
    )


def resize_image(image: Tensor, width: int, height: int) -> Tensor:
    """Image `(height, width, channel)` averaged or interpolated to another size."""
    shrinks = width * height < image.shape[0] * image.shape[1]
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return torch.from_numpy(cv2.resize(image.contiguous().numpy(), (width, height), interpolation=method))


def visible_share(optical_length: Tensor) -> Tensor:
    """Which cloud pixels count in histograms `(pixel,)` bool."""
    return optical_length > FAINTEST_SHARE * optical_length.max()


def brightest_radiance(stack: ScatteringStack) -> float:
    """Radiance of the cloud's bright parts for unit sunlight and an albedo of 0.8, at the asymmetry that is worst off.

    The 95th percentile over the pixels is taken at each node, then the largest over extinction and the smallest over asymmetry: a
    thin cloud could only reach the same with a sun that no thick one needs.
    """
    tables = stack.tables
    rank = max(1, math.ceil(0.95 * len(tables.pixel)))
    powers = DARKEST_ALBEDO**tables.knots
    brightest = []
    for number, asymmetry in enumerate(tables.asymmetry):
        phase = evaluate_phase_function(tables.cos_sun, asymmetry)
        total = DARKEST_ALBEDO * phase * tables.single + torch.einsum("k,ksp->sp", powers, tables.multiple[:, number])
        brightest.append(float(total.kthvalue(rank, dim=1).values.max()))
    return max(min(brightest), 1e-12)


@dataclass(frozen=True, eq=False)
class FitProblem:
    """Losses of whole populations in the unit cube.

    Args:
        analysis: of the photograph.
        stack: of the scene.
        ambient: colour of the ambient light.
        display_curve: applied to both sides before the histograms.
        air_refinements: of the search over the air; 0 is the paper's.
    """

    analysis: PhotographAnalysis
    stack: ScatteringStack
    ambient: Ambient = "sun"
    display_curve: str = "srgb"
    air_refinements: int = AIR_REFINEMENTS

    @cached_property
    def space(self) -> SearchSpace:
        """The searched parameters; sunlight just strong enough for the photograph's brightest cloud at every asymmetry."""
        tables = self.stack.tables
        strongest = SUNLIGHT_HEADROOM * self._brightest_grey / brightest_radiance(self.stack)
        return cloud_search_space(
            tables.largest_optical_length,
            self.ambient,
            (float(tables.extinction[0]), float(tables.extinction[-1])),
            (float(tables.asymmetry[0]), float(tables.asymmetry[-1])),
            (strongest / SUNLIGHT_SPAN, strongest),
        )

    @cached_property
    def _brightest_grey(self) -> float:
        """99th percentile of the photograph's grey cloud pixels, at most display white."""
        grey = self.analysis.photograph.pixels[self.analysis.mask.cloud].mean(1).clamp(0.0, 1.0)
        return max(float(grey.kthvalue(math.ceil(0.99 * len(grey))).values), 1.0 / 255.0)

    @cached_property
    def target(self) -> Tensor:
        """Histogram of the photograph's cloud pixels `(channel, bin)`."""
        pixels = self.analysis.photograph.pixels[self.analysis.mask.cloud]
        return colour_histogram(pixels, self.display_curve)

    @cached_property
    def counted(self) -> Tensor:
        """Numbers of the stack's cloud pixels that count in the histogram."""
        return torch.nonzero(visible_share(self.stack.optical_length)).flatten()

    @cached_property
    def sky(self) -> Tensor:
        """Sky behind the counted pixels `(channel, pixel)`."""
        image = resize_image(self.analysis.sky, self.stack.tables.width, self.stack.tables.height)
        return image.flatten(0, 1)[self.stack.pixel[self.counted]].T.contiguous()

    @cached_property
    def floor(self) -> float:
        """Loss that two images of equal appearance reach on the stack's pixels; nothing below it can be told apart."""
        return self.floor_of(len(self.counted))

    def floor_of(self, pixels: int) -> float:
        """The floor for a picture with so many counted pixels: that of two samples as large as the harmonic mean of both."""
        photographed = int(self.analysis.mask.cloud.sum())
        size = max(1, round(2.0 / (1.0 / photographed + 1.0 / pixels)))
        return float(l1_floor(self.target, size).mean())

    def lighting(self, physical: Tensor) -> Lighting:
        """Light of candidates in units `(population, parameter)`."""
        sunlight = self.analysis.sunlight
        column = {name: physical[:, number] for number, name in enumerate(self.space.names)}
        colour = {"sun": sunlight.colour, "sky": sunlight.ambient_sky_colour}.get(self.ambient)
        if colour is None:
            colour = torch.stack([column[f"ambient_{name}"] for name in ("red", "green", "blue")], dim=1)
        return Lighting(column["sunlight_intensity"], sunlight.colour, column["ambient"], colour)

    def compose(self, physical: Tensor) -> Tensor:
        """Radiance of the counted pixels without air `(population, channel, pixel)`; differentiable."""
        column = {name: physical[:, number] for number, name in enumerate(self.space.names)}
        layers = self.stack(column["asymmetry"], column["extinction"], column["albedo"])
        counted = CloudLayers(
            layers.single[:, self.counted],
            layers.multiple[:, self.counted],
            layers.transmittance[:, self.counted],
            layers.opacity[:, self.counted],
        )
        return compose_cloud(counted, self.lighting(physical), self.sky)

    @torch.no_grad()
    def evaluate(self, population: Tensor) -> Tensor:
        """Objective of candidates.

        Args:
            population: `(population, parameter)` in the unit cube.

        Returns:
            Losses `(population,)`; candidates between table nodes that miss the accepted error get the worst loss.
        """
        losses = []
        for part in population.split(POPULATION_CHUNK):
            physical = self.space.to_physical(part.to(torch.float32))
            cloud = self.compose(physical)
            air = search_haze(cloud, self.sky, self.target, self.display_curve, self.air_refinements)
            usable = self.stack.is_usable(physical[:, 1], physical[:, 2])
            losses.append(torch.where(usable, air.loss.mean(1), LOSSES["l1"].worst))
        return torch.cat(losses)
