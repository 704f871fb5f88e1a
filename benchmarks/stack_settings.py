"""Settings of a stack that differ from a preset in one knob each."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from benchmarks.parameter_sets import DEPTH, Constant
from cloudfit.colour_histogram import LEVELS
from cloudfit.quality import Quality
from precompute import group_task, smoothing, source_model
from precompute.error_budget import Effort
from render.depth_nodes import step_of_depths


@dataclass(frozen=True)
class Recipe:
    """What a stack's tables depend on, beside the scene and the seed.

    Args:
        quality: effort and numbers of nodes.
        width, height: of the tables.
        constants: of modules that have other values while it is built.
    """

    quality: Quality
    width: int
    height: int
    constants: tuple[Constant, ...] = ()


@dataclass(frozen=True)
class Setting:
    """One point of the comparison.

    Args:
        knob: what differs from the preset; "preset" where nothing does.
        value: of the knob, in words.
        recipe: of the tables.
        rounded: whether the tables are rounded as those on disk are.
        bins: of the display histograms; a divisor of 256.
    """

    knob: str
    value: str
    recipe: Recipe
    rounded: bool = True
    bins: int = LEVELS

    @property
    def effort(self) -> Effort:
        """Of the tables."""
        return self.recipe.quality.table_effort

    def with_effort(self, knob: str, value: str, effort: Effort) -> "Setting":
        """The same with another effort."""
        quality = replace(self.recipe.quality, table_effort=effort)
        return replace(self, knob=knob, value=value, recipe=replace(self.recipe, quality=quality))

    def with_recipe(self, knob: str, value: str, recipe: Recipe) -> "Setting":
        """The same with another recipe."""
        return replace(self, knob=knob, value=value, recipe=recipe)


def preset_setting(quality: Quality, width: int, height: int) -> Setting:
    """The preset itself."""
    return Setting("preset", "as it is", Recipe(quality, width, height))


def _tolerance(base: Setting) -> list[Setting]:
    effort, known = base.effort, base.effort.tolerance or 0.02
    settings = []
    for factor in (5.0, 2.5, 0.5):
        paths = round(effort.paths * max(1.0, factor**-2))
        changed = replace(effort, tolerance=factor * known, paths=paths)
        settings.append(base.with_effort("tolerance", f"{factor * known:.1%}", changed))
    return settings


def _paths(base: Setting) -> list[Setting]:
    effort = base.effort
    counts = [max(1, round(share * effort.paths)) for share in (1 / 16, 1 / 4, 1.0)]
    return [
        base.with_effort("paths", f"just {count / 1e6:.3g} M", replace(effort, paths=count, tolerance=None))
        for count in counts
    ]


def _points(base: Setting) -> list[Setting]:
    effort = base.effort
    counts = [round(factor * effort.points) for factor in (0.25, 0.5, 2.0)]
    return [base.with_effort("points", f"{count / 1e3:.3g} k", replace(effort, points=count)) for count in counts]


def _orders(base: Setting) -> list[Setting]:
    effort = base.effort
    settings = [base.with_effort("orders", "4", replace(effort, orders=4, tail=False))]
    for orders in (10, 66):
        for tail in (False, True):
            name = f"{orders}{' + tail' if tail else ''}"
            settings.append(base.with_effort("orders", name, replace(effort, orders=orders, tail=tail)))
    return [*settings, base.with_effort("orders", "258", replace(effort, orders=258, tail=False))]


def _asymmetry_nodes(base: Setting) -> list[Setting]:
    quality = base.recipe.quality
    return [
        base.with_recipe("asymmetry nodes", str(count), replace(base.recipe, quality=replaced))
        for count in _node_counts(quality.asymmetry_nodes)
        for replaced in [replace(quality, asymmetry_nodes=count)]
    ]


def _extinction_nodes(base: Setting) -> list[Setting]:
    quality = base.recipe.quality
    return [
        base.with_recipe("extinction nodes", str(count), replace(base.recipe, quality=replaced))
        for count in _node_counts(len(quality.place_depths(*DEPTH)))
        for replaced in [replace(quality, extinction_step=step_of_depths(*DEPTH, count))]
    ]


def _node_counts(usual: int) -> tuple[int, int, int]:
    """About half, two thirds and four thirds of the preset's."""
    return max(3, round(usual / 2)), max(4, round(usual / 1.5)), round(usual * 4 / 3)


def _strata(base: Setting) -> list[Setting]:
    effort = base.effort
    counts = [max(1, effort.strata // 4), max(1, effort.strata // 2), 2 * effort.strata]
    return [base.with_effort("strata", str(count), replace(effort, strata=count)) for count in counts]


def _step(base: Setting) -> list[Setting]:
    names = ("STEP_DEPTH", "SMALLEST_STEP", "LARGEST_STEP")
    settings = []
    for factor in (0.5, 2.0, 4.0):
        constants = tuple((group_task, name, factor * getattr(group_task, name)) for name in names)
        settings.append(base.with_recipe("step", f"x {factor:g}", replace(base.recipe, constants=constants)))
    return settings


def _smoothing(base: Setting) -> list[Setting]:
    variants: dict[str, Constant] = {
        "none": (smoothing.Neighbourhood, "levels", lambda neighbours, source, expected: [source]),
        "without a model": (source_model, "POINTS_PER_FEATURE", math.inf),
        "model alone": (smoothing, "LEVELS", 0),
        "1 level": (smoothing, "LEVELS", 1),
    }
    return [
        base.with_recipe("smoothing", name, replace(base.recipe, constants=(constant,)))
        for name, constant in variants.items()
    ]


def _storage(base: Setting) -> list[Setting]:
    return [replace(base, knob="storage", value="single precision", rounded=False)]


def _bins(base: Setting) -> list[Setting]:
    return [replace(base, knob="bins", value=str(bins), bins=bins) for bins in (64, 128)]


def _resolution(base: Setting) -> list[Setting]:
    width, height = base.recipe.width // 2, base.recipe.height // 2
    return [
        base.with_recipe("resolution", f"{width} x {height}", replace(base.recipe, width=width, height=height)),
    ]


KNOBS: Mapping[str, Callable[[Setting], list[Setting]]] = MappingProxyType(
    {
        "tolerance": _tolerance,
        "paths": _paths,
        "points": _points,
        "orders": _orders,
        "asymmetry-nodes": _asymmetry_nodes,
        "extinction-nodes": _extinction_nodes,
        "strata": _strata,
        "step": _step,
        "smoothing": _smoothing,
        "storage": _storage,
        "bins": _bins,
        "resolution": _resolution,
    }
)
