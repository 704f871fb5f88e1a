"""Which smoothing each image of a source gets, and the errors that remain, measured on some of the rays."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from precompute.gather import Lattice, Strata, gather_bags
from precompute.heap import trim_heap
from precompute.light_lattice import LightLattice
from precompute.order_plan import SEPARATE_ORDERS, OrderPlan, close_tail
from precompute.smoothing import LevelErrors, Neighbourhood, measure_levels, steady_changes
from precompute.source_model import SourceModel
from precompute.view import View
from render.phase_functions import evaluate_phase_function
from render.scattering_stack import sum_tail

PROBE_RAYS = 4000
"""Rays on which errors are estimated."""

MANY_POINTS = 50_000
"""Beyond which freed memory is given back after every image: 0.2 GB less at 100 thousand points, but a tenth of a small table's time."""


@dataclass(frozen=True, eq=False)
class ImageErrors:
    """Relative RMS errors of images at one extinction.

    Args:
        of_knots: of each image `(knot, asymmetry)`.
        of_image: of the composed image `(albedo, asymmetry)`.
        of_bright: the same at albedo one, with the orders beyond the last where they are added `(asymmetry,)`.
    """

    of_knots: Tensor
    of_image: Tensor
    of_bright: Tensor

    def times(self, factor: float) -> "ImageErrors":
        """The same with every error larger by a factor."""
        return ImageErrors(factor * self.of_knots, factor * self.of_image, factor * self.of_bright)


@dataclass(frozen=True, eq=False)
class SmoothSource:
    """The source at one extinction, each column at its best level of smoothing.

    Args:
        source: mean of both halves `(point, knot, asymmetry)`.
        errors: that are left.
    """

    source: Tensor
    errors: ImageErrors


@dataclass(frozen=True, eq=False)
class SmoothedImages:
    """Images of the rays at one extinction.

    Args:
        smooth: with the smoothing that was chosen `(ray, half, knot, asymmetry)`.
        change: of them by it, likewise.
        steady: the same as `steady_changes` tells it, likewise.
        missed: what interpolation between the points may have missed of them `(ray, knot, asymmetry)`.
    """

    smooth: Tensor
    change: Tensor
    steady: Tensor
    missed: Tensor


class ErrorProbe:
    """Estimates errors of a source on some of the rays.

    Args:
        view: of all rays.
        lattice: of the source points.
        entry: number of each lattice point among the source points `(lattice point,)` int32.
        strata: of all rays.
        single: single scattering and its error, each `(extinction, ray)`.
        asymmetry: nodes `(asymmetry,)`.
        plan: of the orders.
        albedo: at which the composed image is judged `(albedo,)`.
        tail: whether the orders beyond the last are added by their decay.
    """

    def __init__(
        self,
        view: View,
        lattice: Lattice,
        entry: Tensor,
        strata: Strata,
        single: tuple[Tensor, Tensor],
        asymmetry: Tensor,
        plan: OrderPlan,
        albedo: Tensor,
        tail: bool = False,
    ) -> None:
        self.rays = probe_rays(len(view.pixel))
        part = view.part(self.rays)
        some = strata.part(self.rays)
        self._bags: list[list[tuple[Tensor, Tensor]]] = [[] for _ in strata.opacity]
        for bags in gather_bags(lattice, part.origin, part.direction, some):
            self._bags[bags.extinction].append((entry[bags.numbers], bags.weights))
        phase = evaluate_phase_function(part.direction @ view.sun, asymmetry[:, None])
        self._single, self._single_error = ((phase[:, None] * one[:, self.rays]).double() for one in single)
        self._albedo, self._powers = albedo.double(), albedo.double()[:, None] ** torch.tensor(plan.knots)
        self._plan, self._tail = plan, tail

    def gather(self, node: int, source: Tensor) -> Tensor:
        """Images `(ray, half, asymmetry)` of a source `(point, half, asymmetry)` at one extinction."""
        source = source.flatten(1)
        rows = [embedding_bag(bag, source, per_sample_weights=weights, mode="sum") for bag, weights in self._bags[node]]
        return torch.cat(rows).unflatten(1, (2, -1))

    def composed(self, node: int, smoothed: SmoothedImages) -> Tensor:
        """Relative RMS error of composed images `(albedo, asymmetry)` at one extinction."""
        powers = self._powers[:, None, :, None].expand(-1, 2, -1, smoothed.smooth.shape[3])
        return self._weighted(node, smoothed, self._albedo, powers)

    def brightest(self, node: int, smoothed: SmoothedImages) -> Tensor:
        """The same at albedo one `(asymmetry,)`; each half closes its tail by itself, since a noisy decay makes a noisy tail."""
        smooth = smoothed.smooth
        powers = torch.ones(1, *smooth.shape[1:], dtype=torch.float64)
        if self._tail and self._plan.largest_order > SEPARATE_ORDERS:
            ratio, share = close_tail(self._plan, smooth.double().mean(0).movedim(1, 0))
            beyond = sum_tail(ratio.flatten(), self._plan.largest_order).unflatten(0, ratio.shape)
            powers[0, :, -1] += share * beyond
        return self._weighted(node, smoothed, torch.ones(1, dtype=torch.float64), powers)[0]

    def _weighted(self, node: int, smoothed: SmoothedImages, albedo: Tensor, powers: Tensor) -> Tensor:
        """Relative RMS error `(albedo, asymmetry)` of images with weights `(albedo, half, knot, asymmetry)`."""
        images = (smoothed.smooth, smoothed.change, smoothed.steady)
        of_smooth, *changes = (torch.einsum("ahkg,rhkg->rhag", powers, image.double()) for image in images)
        errors = LevelErrors.of(of_smooth, *changes)
        total = albedo[:, None] * self._single[:, node].T[:, None] + of_smooth.mean(1)
        of_single = albedo[:, None].square() * self._single_error[:, node].square().mean(1)
        of_points = torch.einsum("akg,rkg->rag", powers.mean(1), smoothed.missed.double()).square().mean(0)
        return relative_error(errors.total + of_points + of_single, total.square().mean(0))

    def smooth(
        self,
        node: int,
        source: Tensor,
        neighbours: Neighbourhood,
        model: SourceModel,
        points: LightLattice,
        sharpened: bool,
    ) -> SmoothSource:
        """Smooth the source at one extinction, image by image so that the levels of one only are held at once.

        What sharpening would change tells the size of what linear interpolation misses, whether it is done or not.

        Args:
            node: number of the extinction.
            source: noisy, `(point, half, knot, asymmetry)`.
            neighbours: of the points.
            model: of the source at this extinction.
            points: the source points.
            sharpened: whether the result is to be.
        """
        result, of_knots, seen = [], [], list[tuple[Tensor, Tensor, Tensor, Tensor]]()
        for knot in range(source.shape[2]):
            columns = source[:, :, knot].flatten(1)
            levels = [level.unflatten(1, (2, -1)) for level in neighbours.levels(columns, model.expect(columns))]
            images = [self.gather(node, level) for level in levels]
            squares = measure_levels(images).total
            best = squares.argmin(0)
            plain = _choose(levels, best).mean(1)
            sharp = points.sharpen(plain)
            missed = self.gather(node, torch.stack([plain, sharp], dim=1)).diff(dim=1)[:, 0]
            smooth = _choose(images, best)
            seen.append((smooth, smooth - images[0], _choose(steady_changes(images), best), missed))
            power = smooth.double().mean(1).square().mean(0)
            square = squares.gather(0, best[None])[0] + missed.double().square().mean(0)
            of_knots.append(relative_error(square, power))
            result.append(sharp if sharpened else plain)
            del columns, levels, plain, sharp
            if len(source) > MANY_POINTS:
                trim_heap()
        smoothed = SmoothedImages(*(torch.stack(images, dim=-2) for images in zip(*seen, strict=True)))
        errors = ImageErrors(torch.stack(of_knots), self.composed(node, smoothed), self.brightest(node, smoothed))
        return SmoothSource(torch.stack(result, dim=1), errors)


def probe_rays(count: int) -> Tensor:
    """Numbers of the rays on which errors are estimated, evenly spread."""
    return torch.arange(count) if count <= PROBE_RAYS else torch.linspace(0, count - 1, PROBE_RAYS).long()


def _choose(levels: list[Tensor], best: Tensor) -> Tensor:
    """The best level of each column out of `(..., half, asymmetry)` tensors, `best` `(asymmetry,)`."""
    chosen = levels[0]
    for number, level in enumerate(levels[1:], start=1):
        chosen = torch.where(best == number, level, chosen)
    return chosen


def relative_error(square: Tensor, power: Tensor) -> Tensor:
    """Root of a mean squared error over a mean square; zero for an image that is black."""
    return torch.where(power > 0, (square / power.clamp(min=1e-300)).sqrt(), 0.0)
