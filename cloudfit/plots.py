"""Small figures for the pages, as SVG that takes its colours of text and lines from the page around it."""

import io
import re
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

# Stand-ins that no curve uses; in the page they become the colours of its light or dark theme.
INK, FAINT = "#010203", "#040506"
THEME = {INK: "currentColor", FAINT: "var(--line)"}

CHANNEL_COLOURS = {"red": "#d9534f", "green": "#3b9c5f", "blue": "#3d7dd8"}

ACCENT = "#e08a1e"

SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",
    "font.size": 10,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def histogram_figure(photograph: Tensor, picture: Tensor) -> str:
    """Histograms of the cloud pixels, one panel for each channel: the photograph filled, the picture as a line.

    Args:
        photograph: shares of pixels `(channel, bin)`.
        picture: the same of the picture.

    Returns:
        An SVG element.
    """
    with matplotlib.rc_context({**SETTINGS, "svg.hashsalt": "histogram"}):
        figure = Figure(figsize=(10.5, 2.7), layout="constrained")
        panels = figure.subplots(1, 3, sharey=True)
        first, second = photograph.numpy(), picture.numpy()
        levels = np.arange(first.shape[1])
        for panel, (name, colour), wanted, got in zip(panels, CHANNEL_COLOURS.items(), first, second, strict=True):
            panel.fill_between(levels, 100 * wanted, step="mid", color=colour, alpha=0.35, linewidth=0)
            panel.step(levels, 100 * got, where="mid", color=INK, linewidth=1.0)
            panel.set(xlim=(0, levels[-1]), ylim=(0, None), xticks=[0, 64, 128, 192, 255], title=name)
            draw_rules(panel)
        panels[0].set_ylim(0, 100 * _readable_top(first, second))
        panels[0].set_ylabel("pixels [%]")
        panels[1].set_xlabel("display level")
        return to_svg(figure, "Histograms of the clouds: photograph filled, picture as a line")


def convergence_figure(history: Sequence[float | None], floor: float | None) -> str:
    """Best loss after each iteration, and the floor below which differences mean nothing.

    Args:
        history: losses [1]; None where there is none yet.
        floor: of the loss [1], or None.

    Returns:
        An SVG element.
    """
    with matplotlib.rc_context({**SETTINGS, "svg.hashsalt": "convergence"}):
        figure = Figure(figsize=(10.5, 2.4), layout="constrained")
        axes = figure.subplots()
        losses = np.array([np.nan if loss is None else loss for loss in history], dtype=float)
        axes.step(np.arange(1, len(losses) + 1), losses, where="post", color=ACCENT, linewidth=2.0)
        if len(losses) == 1:
            axes.plot([1], losses, "o", color=ACCENT)
        if floor is not None:
            axes.axhline(floor, color=INK, linewidth=1.0, linestyle=(0, (4, 3)))
            axes.annotate(
                f"floor {floor:.3f}", (1, floor), (-4, 4), ("axes fraction", "data"), "offset points", ha="right"
            )
        known = losses[np.isfinite(losses)]
        top = 1.1 * max(float(known.max(initial=0.0)), floor or 0.0)
        axes.set(xlabel="iteration", ylabel="best loss", ylim=(0, top or 1.0), xlim=(1, max(2, len(losses))))
        draw_rules(axes)
        return to_svg(figure, "Best loss after each iteration")


def _readable_top(first: np.ndarray, second: np.ndarray) -> float:
    """Height of the panels: saturated pixels pile up in the last level and would flatten all else."""
    inner = np.concatenate([first[:, 1:-1], second[:, 1:-1]])
    top = float(inner.max())
    return 1.08 * top if top > 0 else 1.0


def draw_rules(axes: Axes) -> None:
    """Faint horizontal lines behind what is drawn."""
    axes.grid(axis="y", color=FAINT, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(length=0)


def to_svg(figure: Figure, label: str) -> str:
    """The SVG element alone, with a label for those who cannot see it, and a size that follows the page."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(
        r'(<svg[^>]*?) width="[^"]*"', r"\1", re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1), count=1
    )
    for stand_in, colour in THEME.items():
        text = text.replace(stand_in, colour)
    return text.replace("<svg", f'<svg role="img" aria-label="{label}"', 1)
