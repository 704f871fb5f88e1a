"""Which settings are not beaten in both time and error, and a drawing of all of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

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
    """Write the drawing as PNG and SVG, both axes logarithmic; returns the files."""
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
        for point in points:
            axes.annotate(point.label, (point.seconds, point.error), (5, 4), textcoords="offset points", fontsize=7)
        front = [points[number] for number in pareto_front(points)]
        steps = [point.seconds for point in front], [point.error for point in front]
        axes.step(*steps, where="post", color="0.5", linewidth=1.2, label="not beaten in both", zorder=2)
        axes.set(xscale="log", yscale="log", xlabel=seconds_name, ylabel=error_name, title=title)
        axes.grid(which="both", color="0.9", linewidth=0.6)
        axes.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
        files = [folder / f"{name}.{kind}" for kind in ("png", "svg")]
        for file in files:
            figure.savefig(file, dpi=150, metadata={"Date": None} if file.suffix == ".svg" else None)
    return files
