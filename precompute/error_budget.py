"""How accurate a stack shall be, how accurate it has become, and how much more work that calls for.

The accepted error, the tolerance, is a relative RMS error over the pixels of the composed cloud image, root of mean (image - truth)^2 over
mean image^2, at albedos of the search box. It is estimated on some of the rays from two independent halves of the paths: noise from their
difference, the error made by smoothing as in `smoothing`. Eleven of twelve combinations of asymmetry, extinction and albedo shall meet
the tolerance: the last twelfth is narrow forward lobes in thick clouds at albedo one, which would multiply the work.
"""

from dataclasses import dataclass
from enum import Enum

from torch import Tensor

from render.errors import ParameterError

ALBEDOS = (0.82, 0.86, 0.90, 0.94, 0.98)
"""Albedos at which errors are judged: midpoints of 0.8 to 1, the range of clouds."""

MET_SHARE = 11.0 / 12.0
"""Share of the combinations that shall meet the tolerance."""

FIRST_SHARE = 1.0 / 8.0
"""Of the largest number of paths that the first pass spends, to see what the tolerance needs."""

LEAST_GROWTH, MOST_GROWTH = 0.5, 7.0
"""Paths of a further pass over those so far."""

OMITTED_SHARE = 0.25
"""Of the tolerance that leaving out the highest orders may cost at the judged albedos; at an albedo of one, the whole of it."""


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
        orders: largest number of scatterings that is traced, at least two; above four, 6, 10, 18, 34, 66, 258 cost least.
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
        carried_points: of the lattice on which the higher orders were carried, zero where paths went on to the last.
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
    carried_points: int
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
    if effort.paths - done - wanted < LEAST_GROWTH * (done + wanted):
        wanted = effort.paths - done  # the rest would be too few for a pass of their own
    if effort.max_seconds is not None:
        affordable = int((effort.max_seconds - seconds) / seconds_a_path)
        if affordable < least:
            return StopReason.SECONDS
        wanted = min(wanted, affordable)
    return wanted


def box_error(errors: Tensor) -> float:
    """Error that eleven of twelve combinations do not exceed."""
    return float(errors.flatten().double().quantile(MET_SHARE)) if errors.numel() else 0.0
