"""How accurate a stack shall be, how accurate it has become, and how much more work that calls for.

The accepted error, the tolerance, is a relative RMS error over the pixels of the composed cloud image, root of mean (image - truth)^2 over
mean image^2, at albedos of the search box. It is estimated on some of the rays from two independent halves of the paths: noise from their
difference, the error made by smoothing as in `smoothing`. Eleven of twelve combinations of asymmetry, extinction and albedo shall meet
the tolerance: the last twelfth is narrow forward lobes in thick clouds at albedo one, which would multiply the work.
"""

from dataclasses import dataclass
from enum import Enum

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from precompute.gather import Lattice, Strata, gather_bags
from precompute.smoothing import LevelErrors, measure_levels
from precompute.view import View
from render.errors import ParameterError
from render.phase_functions import evaluate_phase_function

ALBEDOS = (0.82, 0.86, 0.90, 0.94, 0.98)
"""Albedos at which errors are judged: midpoints of 0.8 to 1, the range of clouds."""

MET_SHARE = 11.0 / 12.0
"""Share of the combinations that shall meet the tolerance."""

FIRST_SHARE = 1.0 / 16.0
"""Of the largest number of paths that the first pass spends, to see what the tolerance needs."""

LEAST_GROWTH, MOST_GROWTH = 0.5, 7.0
"""Paths of a further pass over those so far."""

OMITTED_SHARE = 0.25
"""Of the tolerance that leaving out the highest orders may cost."""

PROBE_RAYS = 4000
"""Rays on which errors are estimated."""


class StopReason(Enum):
    """Why no more paths were traced."""

    TOLERANCE = "the tolerance is met"
    PATHS = "the largest number of paths is spent"
    SECONDS = "the time is up"
    FIXED = "the number of paths was given"
    SINGLE = "single scattering is enough for the tolerance"


@dataclass(frozen=True)
class Effort:
    """How much work a stack is worth.

    Args:
        orders: largest number of scatterings that is traced, at least two; above four, 6, 10, 18, 34, 66 ... cost least.
        points: source points of each group, about.
        paths: over all groups, about; with a tolerance the most that may be spent.
        strata: positions along each camera ray.
        tail: whether the orders beyond the largest are added by their measured decay.
        tolerance: accepted relative RMS error, or None for just this number of paths and orders.
        max_seconds: after which no further pass begins, or None.
    """

    orders: int = 4
    points: int = 120_000
    paths: int = 3_000_000
    strata: int = 16
    tail: bool = False
    tolerance: float | None = None
    max_seconds: float | None = None

    def __post_init__(self) -> None:
        if self.orders < 2 or min(self.points, self.paths, self.strata) < 1:
            raise ParameterError(f"a stack needs at least two orders and one point, path and stratum, not {self}")
        if any(limit is not None and not limit > 0.0 for limit in (self.tolerance, self.max_seconds)):
            raise ParameterError(f"a tolerance and a number of seconds must be positive, not {self}")

    @property
    def first_paths(self) -> int:
        """Paths of the first pass."""
        if self.tolerance is None:
            return self.paths
        return min(self.paths, max(round(FIRST_SHARE * self.paths), 4 * self.points))


@dataclass(frozen=True)
class GroupReport:
    """What was done for a group of extinction nodes.

    Args:
        thinnest, thickest: largest optical depth of a view ray at its nodes.
        largest_order: that was traced; one where single scattering is enough.
        omitted_share: of the mean image that the orders left out have, at the node where it is largest; from a pilot.
        points, spacing: source points, and their distance [voxel].
        paths: traced.
        error: relative RMS error that eleven of twelve nodes and albedos do not exceed, estimated.
        stop_reason: sentence.
        seconds: by part.
    """

    thinnest: float
    thickest: float
    largest_order: int
    omitted_share: float
    points: int
    spacing: float
    paths: int
    error: float
    stop_reason: str
    seconds: dict[str, float]


def next_pass(effort: Effort, done: int, error: float, seconds: float, seconds_a_path: float) -> int | StopReason:
    """Number of paths of the next pass, or why there is none.

    The noise falls with the root of the number of paths, so (error / tolerance)^2 as many are needed.

    Args:
        effort: what is allowed.
        done: paths so far.
        error: so far.
        seconds: that have passed.
        seconds_a_path: that a path has taken.
    """
    if effort.tolerance is None:
        return StopReason.FIXED
    if error <= effort.tolerance:
        return StopReason.TOLERANCE
    least = round(LEAST_GROWTH * done)
    wanted = min(max(round(done * ((error / effort.tolerance) ** 2 - 1.0)), least), round(MOST_GROWTH * done))
    if effort.paths - done < least:
        return StopReason.PATHS
    wanted = min(wanted, effort.paths - done)
    if effort.max_seconds is not None:
        affordable = int((effort.max_seconds - seconds) / seconds_a_path)
        if affordable < least:
            return StopReason.SECONDS
        wanted = min(wanted, affordable)
    return wanted


@dataclass(frozen=True, eq=False)
class NodeErrors:
    """Errors at one extinction, with the best level of smoothing for each image.

    Args:
        level: which `(knot, asymmetry)`.
        of_knots: relative RMS error of each image `(knot, asymmetry)`.
        of_image: of the composed image `(albedo, asymmetry)`.
    """

    level: Tensor
    of_knots: Tensor
    of_image: Tensor


class ErrorProbe:
    """Estimates errors of a source on some of the rays.

    Args:
        view: of all rays.
        lattice: of the source points.
        entry: number of each lattice point among the source points `(lattice point,)` int32.
        strata: of all rays.
        single: single scattering `(extinction, ray)`.
        asymmetry: nodes `(asymmetry,)`.
        knots: exponents of the albedo `(knot,)`.
        albedo: at which the composed image is judged `(albedo,)`.
    """

    def __init__(
        self,
        view: View,
        lattice: Lattice,
        entry: Tensor,
        strata: Strata,
        single: Tensor,
        asymmetry: Tensor,
        knots: Tensor,
        albedo: Tensor,
    ) -> None:
        self.rays = probe_rays(len(view.pixel))
        part = view.part(self.rays)
        some = strata.part(self.rays)
        self._bags: list[list[tuple[Tensor, Tensor]]] = [[] for _ in strata.opacity]
        for bags in gather_bags(lattice, part.origin, part.direction, some):
            self._bags[bags.extinction].append((entry[bags.numbers], bags.weights))
        phase = evaluate_phase_function(part.direction @ view.sun, asymmetry[:, None])
        self._single = (phase[:, None] * single[:, self.rays]).double()
        self._albedo, self._powers = albedo.double(), albedo.double()[:, None] ** knots
        self._shape = (2, len(knots), len(asymmetry))

    def gather(self, node: int, source: Tensor) -> Tensor:
        """Images `(ray, half, knot, asymmetry)` of a source `(point, column)` at one extinction."""
        rows = [embedding_bag(bag, source, per_sample_weights=weights, mode="sum") for bag, weights in self._bags[node]]
        return torch.cat(rows).unflatten(1, self._shape)

    def measure(self, node: int, levels: list[Tensor]) -> NodeErrors:
        """Errors at one extinction of a source `(point, column)` at every level of smoothing, the first without."""
        images = [self.gather(node, level) for level in levels]
        errors = measure_levels(images)
        best = errors.total.argmin(0)
        chosen = choose_levels(images, best)
        power = images[-1].double().mean(1).square().mean(0)
        of_knots = _relative(errors.total.gather(0, best[None])[0], power)
        raw, smooth = (torch.einsum("ak,rhkg->arhg", self._powers, image.double()) for image in (images[0], chosen))
        composed = LevelErrors.of(raw.movedim(0, -1), smooth.movedim(0, -1))
        total = self._albedo[:, None, None] * self._single[:, node].movedim(0, -1) + smooth.mean(2)
        return NodeErrors(best, of_knots, _relative(composed.total.T, total.square().mean(1)))


def probe_rays(count: int) -> Tensor:
    """Numbers of the rays on which errors are estimated, evenly spread."""
    return torch.arange(count) if count <= PROBE_RAYS else torch.linspace(0, count - 1, PROBE_RAYS).long()


def choose_levels(levels: list[Tensor], best: Tensor) -> Tensor:
    """The best level of each column out of `(..., half, knot, asymmetry)` tensors, `best` `(knot, asymmetry)`."""
    chosen = levels[0]
    for number, level in enumerate(levels[1:], start=1):
        chosen = torch.where(best == number, level, chosen)
    return chosen


def box_error(errors: Tensor) -> float:
    """Error that eleven of twelve combinations do not exceed."""
    return float(errors.flatten().double().quantile(MET_SHARE)) if errors.numel() else 0.0


def _relative(square: Tensor, power: Tensor) -> Tensor:
    return torch.where(power > 0, (square / power.clamp(min=1e-300)).sqrt(), 0.0)
