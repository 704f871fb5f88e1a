"""Which settings are not beaten in both time and error, and a drawing of all of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from matplotlib.transforms import Bbox

SETTINGS: dict[Any, Any] = {"svg.fonttype": "none", "svg.hashsalt": "front", "font.size": 9}

COLOURS = "tab20"

MARKERS = "osD^v<>Pp*hX"


@dataclass(frozen=True)
class Point:
    """A setting in the plane of time and error.

    Args:
        group: points of one group share a colour.
        label: beside the point.
        seconds, error: coordinates, positive.
    """

    group: str
    label: str
    seconds: float
    error: float


TICKS = FuncFormatter(lambda value, place: f"{value:.3g}")


def pareto_front(points: Sequence[Point]) -> list[int]:
    """Numbers of the points that no other beats in one coordinate without losing in the other, fastest first."""
    front: list[int] = []
    for number in sorted(range(len(points)), key=lambda n: (points[n].seconds, points[n].error)):
        if not front or points[number].error < points[front[-1]].error:
            front.append(number)
    return front


def draw_front(
    points: Sequence[Point],
    title: str,
    error_name: str,
    folder: Path,
    name: str,
    seconds_name: str = "seconds to build",
) -> list[Path]:
    """Write the drawing as PNG and SVG, both axes logarithmic; returns the files.

    Points of the front are labelled first, others where there is room.
    """
    folder.mkdir(parents=True, exist_ok=True)
    groups = list(dict.fromkeys(point.group for point in points))
    colours = matplotlib.colormaps[COLOURS]
    with matplotlib.rc_context(SETTINGS):
        figure = Figure(figsize=(11.0, 7.0), layout="constrained")
        axes = figure.subplots()
        for number, group in enumerate(groups):
            members = [point for point in points if point.group == group]
            seconds, errors = [point.seconds for point in members], [point.error for point in members]
            marker = MARKERS[number % len(MARKERS)]
            axes.scatter(seconds, errors, 40.0, color=colours(number % 20), marker=marker, label=group, zorder=3)
        front = [points[number] for number in pareto_front(points)]
        steps = [point.seconds for point in front], [point.error for point in front]
        axes.step(*steps, where="post", color="0.5", linewidth=1.2, label="not beaten in both", zorder=2)
        axes.set(xscale="log", yscale="log", xlabel=seconds_name, ylabel=error_name, title=title)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(TICKS)
            axis.set_minor_formatter(TICKS)
        axes.grid(which="both", color="0.9", linewidth=0.6)
        axes.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
        figure.draw_without_rendering()
        _label(axes, [*front, *(point for point in points if point not in front)])
        files = [folder / f"{name}.{kind}" for kind in ("png", "svg")]
        for file in files:
            figure.savefig(file, dpi=150, metadata={"Date": None} if file.suffix == ".svg" else None)
    return files


def _label(axes: Axes, points: Sequence[Point]) -> None:
    """Name points, in this order, whose label would not lie on an earlier one."""
    taken: list[Bbox] = []
    for point in points:
        text = axes.annotate(point.label, (point.seconds, point.error), (5, 4), textcoords="offset points", fontsize=7)
        box = text.get_window_extent()
        if any(box.overlaps(other) for other in taken):
            text.remove()
        else:
            taken.append(box)
