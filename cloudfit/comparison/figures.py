"""Figures of a comparison, as SVG in the style of the other pages."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cloudfit.comparison.analysis import Analysis
from cloudfit.comparison.performance import (
    HIGHEST_EXCESS,
    LOWEST_EXCESS,
    PROFILE_TOLERANCE,
    SUCCESS_EXCESS,
    distribution,
)
from cloudfit.comparison.run_record import Floats
from cloudfit.plots import ACCENT, FAINT, INK, SETTINGS, draw_rules, to_svg

COLOURS = ("#e08a1e", "#3d7dd8", "#3b9c5f", "#d9534f", "#8e5bd0", "#1fa7a0", "#b5799a", "#8a6d3b")
DASHES: tuple[object, ...] = ("solid", (0, (5, 2)), (0, (1.5, 1.5)), (0, (6, 2, 1.5, 2)))

DRAWN_STRONGLY = 12
"""Methods with a colour and a name in a figure of curves; the others are faint lines."""

GRID_POINTS = 400


def figures(analysis: Analysis) -> dict[str, str]:
    """All figures of a comparison by name."""
    return {
        "runtimes_evaluations": runtime_figure(analysis, by_seconds=False),
        "runtimes_seconds": runtime_figure(analysis, by_seconds=True),
        "data_profiles": profile_figure(analysis),
        "final": final_figure(analysis),
        "areas": area_figure(analysis),
        "time": time_figure(analysis),
    }


def runtime_figure(analysis: Analysis, by_seconds: bool) -> str:
    """Runtime distributions over all problems and targets."""
    times = {method: analysis.pooled_runtimes(method, by_seconds) for method in analysis.methods}
    label = "seconds" if by_seconds else "evaluations"
    with _figure(f"runtimes {label}", (10.5, 4.2)) as (figure, (axes,)):
        _draw_distributions(axes, times, analysis.ranking(by_seconds), 0.0 if by_seconds else 1.0)
        axes.set(xlabel=label, ylabel="share of runs and targets reached", ylim=(0, 1), xscale="log")
        return to_svg(figure, f"Runtime distributions in {label}")


def profile_figure(analysis: Analysis) -> str:
    """Data profiles: share of the runs converged within a number of simplex gradients."""
    times = {method: analysis.pooled_gradients(method) for method in analysis.methods}
    with _figure("data profiles", (10.5, 4.2)) as (figure, (axes,)):
        _draw_distributions(axes, times, analysis.ranking(), 1.0)
        axes.set(xlabel="simplex gradients, evaluations / (n + 1)", xscale="log", ylim=(0, 1))
        axes.set_ylabel(f"share of runs converged to {PROFILE_TOLERANCE:g}")
        return to_svg(figure, "Data profiles")


def final_figure(analysis: Analysis) -> str:
    """Final excess of each run: quartiles as boxes, runs as dots, methods in the order of their medians."""
    values = {
        method: np.concatenate([p.excess(method) for p in analysis.problems.values() if method in p.runs])
        for method in analysis.methods
    }
    order = sorted(values, key=lambda method: -float(np.median(values[method])))
    with _figure("final", _size_of_rows(len(order))) as (figure, (axes,)):
        shown = [np.clip(values[method], LOWEST_EXCESS, HIGHEST_EXCESS) for method in order]
        axes.boxplot(
            shown,
            orientation="horizontal",
            tick_labels=order,
            showfliers=False,
            whis=(0, 100),
            boxprops={"color": INK},
            medianprops={"color": ACCENT, "linewidth": 2.0},
            whiskerprops={"color": FAINT},
            capprops={"color": FAINT},
        )
        for row, points in enumerate(shown, 1):
            lift = np.linspace(-0.25, 0.25, len(points))
            axes.plot(points, row + lift, ".", color=COLOURS[1], markersize=3, alpha=0.5)
        axes.axvline(SUCCESS_EXCESS, color=INK, linewidth=1.0, linestyle=(0, (4, 3)))
        axes.set(xscale="log", xlabel="excess over the best loss that anyone found; dashed: 1 %")
        return to_svg(figure, "Final loss of each method")


def area_figure(analysis: Analysis) -> str:
    """Anytime areas over evaluations and over seconds, a dot for each problem and a bar for the mean."""
    order = analysis.ranking()[::-1]
    with _figure("areas", _size_of_rows(len(order)), panels=2) as (figure, panels):
        for axes, by_seconds in zip(panels, (False, True), strict=True):
            for row, method in enumerate(order):
                found = [p.areas(method, by_seconds).mean() for p in analysis.problems.values() if method in p.runs]
                axes.plot(found, [row] * len(found), ".", color=COLOURS[1], markersize=4, alpha=0.6)
                axes.plot([np.mean(found)], [row], "|", color=ACCENT, markersize=12, markeredgewidth=2.5)
            axes.set(xlabel=f"anytime area over log {'seconds' if by_seconds else 'evaluations'}", xlim=(0, 1))
        panels[0].set_yticks(range(len(order)), order)
        panels[1].set_yticks(range(len(order)), [""] * len(order))
        return to_svg(figure, "Anytime area of each method")


def time_figure(analysis: Analysis) -> str:
    """Milliseconds of an evaluation: inside the objective, and the method's own."""
    merits = {method: analysis.merit(method) for method in analysis.methods}
    order = sorted(merits, key=lambda method: -merits[method].seconds / max(1.0, merits[method].evaluations))
    inside, own = (
        [1e3 * getattr(merits[method], name) / max(1.0, merits[method].evaluations) for method in order]
        for name in ("objective_seconds", "overhead_seconds")
    )
    with _figure("time", _size_of_rows(len(order))) as (figure, (axes,)):
        axes.barh(range(len(order)), inside, color=COLOURS[1], label="objective")
        axes.barh(range(len(order)), own, left=inside, color=ACCENT, label="method")
        axes.set_yticks(range(len(order)), order)
        axes.set(xlabel="wall milliseconds for each evaluation, median run")
        axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
        return to_svg(figure, "Wall time of an evaluation")


def _draw_distributions(axes: Axes, times: Mapping[str, Floats], ranking: Sequence[str], begin: float) -> None:
    """A curve for each method from a time on, or from the first that is known: the best in colours, the others faint.

    A method's colour and dashes are its place in `times`, the same in every figure.
    """
    reached = np.concatenate([values[np.isfinite(values)] for values in times.values()])
    positive = reached[reached > 0]
    low, high = (float(positive.min()), float(positive.max())) if len(positive) else (1.0, 10.0)
    low = begin or low
    grid = np.geomspace(low, max(high, 2.0 * low), GRID_POINTS)
    for method in ranking[DRAWN_STRONGLY:]:
        axes.step(grid, distribution(times[method], grid), where="post", color=FAINT, linewidth=1.0)
    places = {method: number for number, method in enumerate(times)}
    for method in ranking[:DRAWN_STRONGLY]:
        number = places[method]
        style = DASHES[number // len(COLOURS) % len(DASHES)]
        colour = COLOURS[number % len(COLOURS)]
        curve = distribution(times[method], grid)
        axes.step(grid, curve, where="post", color=colour, linestyle=style, linewidth=1.8, label=method)
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=9)


def _size_of_rows(rows: int) -> tuple[float, float]:
    return 10.5, 1.0 + 0.27 * max(3, rows)


@contextmanager
def _figure(salt: str, size: tuple[float, float], panels: int = 1) -> Iterator[tuple[Figure, list[Axes]]]:
    with matplotlib.rc_context({**SETTINGS, "svg.hashsalt": salt}):
        figure = Figure(figsize=size, layout="constrained")
        axes = list(np.ravel(figure.subplots(1, panels)))
        for one in axes:
            draw_rules(one)
        yield figure, axes
