"""Presets that trade time for accuracy; the figures behind them are in benchmarks/results."""

from dataclasses import dataclass, replace

from torch import Tensor

from precompute.error_budget import Effort
from render.depth_nodes import count_depths, place_depths
from render.errors import ParameterError


@dataclass(frozen=True)
class Quality:
    """How much work a fit spends where.

    Args:
        table_scale: size of the stack's images over that of the pictures.
        table_effort: of the stack.
        picture_effort: of each candidate that is rendered again by itself.
        asymmetry_nodes: of the stack, over the searched range.
        extinction_step: between extinctions of the stack, at most, over the coordinate of `render.depth_nodes`: the narrower the range
            of optical depths, the fewer tables.
        largest_image_error: relative RMS error above which a table node is left out of the search.
    """

    table_scale: float
    table_effort: Effort
    picture_effort: Effort
    asymmetry_nodes: int
    extinction_step: float
    largest_image_error: float

    def place_depths(self, thin: float, thick: float) -> Tensor:
        """Largest optical depths of the stack's extinctions between two `(extinction,)`, float64."""
        return place_depths(thin, thick, count_depths(thin, thick, self.extinction_step))

    def limited(self, seconds: float | None) -> "Quality":
        """The same with a limit on the seconds after which a stack gets no further pass of paths."""
        return replace(self, table_effort=replace(self.table_effort, max_seconds=seconds))


def quality_for(tolerance: float) -> Quality:
    """Quality for an accepted relative RMS error of the cloud image.

    The preset with the nearest tolerance, in logarithms, with as many more or fewer paths as the error asks for: their number goes
    with the inverse square of the error.

    Raises:
        ParameterError: for a tolerance outside 0.001..1.
    """
    if not 0.001 <= tolerance <= 1.0:
        raise ParameterError(f"a tolerance must lie between 0.001 and 1, not {tolerance}")

    def adapt(effort: Effort) -> Effort:
        factor = ((effort.tolerance or tolerance) / tolerance) ** 2
        return replace(effort, tolerance=tolerance, paths=max(1, round(factor * effort.paths)))

    def distance(preset: Quality) -> float:
        known = preset.table_effort.tolerance or tolerance
        return max(known / tolerance, tolerance / known)

    nearest = min(QUALITIES.values(), key=distance)
    return replace(nearest, table_effort=adapt(nearest.table_effort), picture_effort=adapt(nearest.picture_effort))


QUALITIES: dict[str, Quality] = {
    "draft": Quality(
        0.25,
        Effort(258, 14_000, 330_000, 6, True, 0.10),
        Effort(258, 60_000, 1_000_000, 16, True, 0.05),
        7,
        0.66,
        0.16,
    ),
    "standard": Quality(
        0.5,
        Effort(258, 100_000, 4_600_000, 16, True, 0.02),
        Effort(258, 150_000, 3_000_000, 16, True, 0.02),
        11,
        0.42,
        0.08,
    ),
    "reference": Quality(
        0.5,
        Effort(258, 200_000, 100_000_000, 24, True, 0.005),
        Effort(258, 400_000, 40_000_000, 24, True, 0.005),
        15,
        0.25,
        0.05,
    ),
}
