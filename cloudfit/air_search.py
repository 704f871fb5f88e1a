"""The linear search over the air: the optical depth of the haze that suits the photograph best, channel by channel.

The air's optical depth enters each channel alone (Dobashi et al. 2012, equation 3), so that the search takes 11 x 3 comparisons a
candidate, not 11^3. Around the best of the 11 it goes on in finer steps.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from cloudfit.colour_histogram import haze_histograms
from cloudfit.fit_types import AIR_DEPTHS, AIR_STEP
from cloudfit.losses import L1, AnyLoss, Loss
from cloudfit.soft_haze import display_values, soft_haze_histograms
from render.cloud_image import blend_air

AIR_SUBDIVISION = 3
"""A third of a step on either side of the best leaves equal steps between the depths that have been tried."""

Score = Callable[[Tensor], Tensor]
"""Optical depths (population, kappa, channel) -> losses of the same shape, NaN where there is none."""


@dataclass(frozen=True, eq=False)
class FoundAir:
    """The best air that was tried.

    Args:
        loss: smallest loss `(population, channel)`.
        air_depth: where it is reached `(population, channel)`.
    """

    loss: Tensor
    air_depth: Tensor


@dataclass(frozen=True, eq=False)
class HazeSearch:
    """Outcome of the linear search over the air.

    Args:
        loss: smallest loss `(population, channel)`.
        air_depth: where it is reached `(population, channel)`.
        histogram: of the image with that air `(population, channel, bin)`.
    """

    loss: Tensor
    air_depth: Tensor
    histogram: Tensor


@dataclass(frozen=True, eq=False)
class Comparison:
    """A photograph as a loss sees it.

    Args:
        loss: any of `LOSSES`.
        target: the photograph's histogram `(channel, bin)`, or what a loss of pixels has prepared.
        histogram: the photograph's histogram in either case.
        display_curve: "srgb" or "none", applied to both sides.
    """

    loss: AnyLoss
    target: Tensor
    histogram: Tensor
    display_curve: str

    def score(self, cloud: Tensor, sky: Tensor, air_depth: Tensor) -> Tensor:
        """Losses of clouds behind several amounts of air; differentiable in the cloud where the loss is.

        Args:
            cloud: radiance `(population, channel, pixel)`.
            sky: radiance behind it `(channel, pixel)`.
            air_depth: `(population, kappa, channel)`.

        Returns:
            `(population, kappa, channel)` float64; NaN for a channel with a value that is not finite.
        """
        if isinstance(self.loss, Loss):
            return self.loss(haze_histograms(cloud, sky, torch.exp(-air_depth), self.display_curve), self.target)
        finite = (cloud.detach().isfinite() & sky.isfinite()).all(-1)
        losses = []
        # One amount of air at a time: the hazy images of all would be eleven times the memory of the clouds.
        for depth in air_depth.unbind(1):
            image = blend_air(cloud, sky, depth.to(cloud.dtype))
            losses.append(self.loss(display_values(image, self.display_curve), self.target))
        return torch.where(finite[:, None], torch.stack(losses, dim=1), torch.nan)

    def find_air(self, cloud: Tensor, sky: Tensor, refinements: int, thirds: bool = False) -> FoundAir:
        """Best optical depth of the air for each candidate and channel.

        Where the loss has a stand-in, the same distance of counted levels, that one chooses the air; the loss returned is its own in any
        case.

        Args:
            cloud: radiance `(population, channel, pixel)`.
            sky: radiance behind it `(channel, pixel)`.
            refinements: of `search_depths`.
            thirds: of `search_depths`.
        """
        shape = len(cloud), len(sky)
        stand_in = None if isinstance(self.loss, Loss) else self.loss.air_stand_in
        if stand_in is None:
            return search_depths(lambda depths: self.score(cloud, sky, depths), *shape, refinements, thirds)

        def estimate(depths: Tensor) -> Tensor:
            if stand_in.is_soft:
                return stand_in.loss(soft_haze_histograms(cloud, sky, depths, self.display_curve), self.target)
            return stand_in.loss(haze_histograms(cloud, sky, torch.exp(-depths), self.display_curve), self.histogram)

        depth = search_depths(estimate, *shape, refinements, thirds).air_depth
        return FoundAir(self.score(cloud, sky, depth[:, None])[:, 0], depth)

    def search(self, cloud: Tensor, sky: Tensor, refinements: int, thirds: bool = False) -> HazeSearch:
        """The same, with the histograms of the images behind the air that was found."""
        found = self.find_air(cloud, sky, refinements, thirds)
        histogram = haze_histograms(cloud, sky, torch.exp(-found.air_depth)[:, None], self.display_curve)[:, 0]
        return HazeSearch(found.loss, found.air_depth, histogram)


def search_haze(cloud: Tensor, sky: Tensor, target: Tensor, display_curve: str, refinements: int) -> HazeSearch:
    """Best optical depth of the air for each candidate and channel by the L1 loss.

    Args:
        cloud: radiance `(population, channel, pixel)`.
        sky: radiance behind it `(channel, pixel)`.
        target: the photograph's histogram `(channel, bin)`.
        display_curve: "srgb" or "none".
        refinements: how often; 0 is the search of the paper.
    """
    return Comparison(L1, target, target, display_curve).search(cloud, sky, refinements)


def search_depths(score: Score, population: int, channels: int, refinements: int, thirds: bool = False) -> FoundAir:
    """Best of the depths tried, from coarse to fine.

    First the 11 depths of the paper; then each refinement cuts the step to a third and tries the best depth so far plus and minus a
    step. Every candidate is searched by itself, so its loss does not depend on its company.

    Args:
        score: losses of depths.
        population: number of candidates.
        channels: number of channels.
        refinements: how often; 0 is the search of the paper.
        thirds: whether to begin with every third of the 11 depths and to reach the others by one refinement more: 6 comparisons
            instead of 11, and now and then a worse optimum.
    """
    first = AIR_DEPTHS[::AIR_SUBDIVISION] if thirds else AIR_DEPTHS
    depths = torch.tensor(first, dtype=torch.float64)[:, None].expand(population, -1, channels)
    found = _best_of(score, depths)
    for refinement in range(0 if thirds else 1, refinements + 1):
        step = AIR_STEP / AIR_SUBDIVISION**refinement
        beside = torch.stack([found.air_depth - step, found.air_depth + step], dim=1)
        found = _better_of(found, _best_of(score, beside.clamp(AIR_DEPTHS[0], AIR_DEPTHS[-1])))
    return found


def _best_of(score: Score, depths: Tensor) -> FoundAir:
    """The best of the given depths `(population, kappa, channel)`."""
    losses = score(depths)
    best = losses.nan_to_num(nan=torch.inf).argmin(1, keepdim=True)
    return FoundAir(losses.gather(1, best)[:, 0], depths.gather(1, best)[:, 0])


def _better_of(first: FoundAir, second: FoundAir) -> FoundAir:
    """The smaller loss of two searches for each candidate and channel; the first where they are equal or not numbers."""
    wins = second.loss < first.loss
    return FoundAir(torch.where(wins, second.loss, first.loss), torch.where(wins, second.air_depth, first.air_depth))
