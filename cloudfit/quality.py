"""Presets that trade time for accuracy; the figures behind them are in benchmarks/results."""

from dataclasses import dataclass

from precompute.error_budget import Effort


@dataclass(frozen=True)
class Quality:
    """How much work a fit spends where.

    Args:
        table_scale: size of the stack's images over that of the pictures.
        table_effort: of the stack.
        picture_effort: of each candidate that is rendered again by itself.
        asymmetry_nodes: of the stack, over the searched range.
        extinction_nodes: of the stack, over the searched range.
        largest_image_error: relative RMS error above which a table node is left out of the search.
    """

    table_scale: float
    table_effort: Effort
    picture_effort: Effort
    asymmetry_nodes: int
    extinction_nodes: int
    largest_image_error: float


QUALITIES: dict[str, Quality] = {
    "draft": Quality(
        0.25,
        Effort(66, 30_000, 1_500_000, 8, True, 0.10),
        Effort(66, 60_000, 1_000_000, 16, True, 0.05),
        7,
        9,
        0.25,
    ),
    "standard": Quality(
        0.5,
        Effort(66, 100_000, 10_000_000, 16, True, 0.02),
        Effort(66, 150_000, 4_000_000, 16, True, 0.02),
        11,
        11,
        0.15,
    ),
    "reference": Quality(
        0.5,
        Effort(66, 200_000, 100_000_000, 24, True, 0.005),
        Effort(66, 400_000, 40_000_000, 24, True, 0.005),
        15,
        15,
        0.08,
    ),
}
