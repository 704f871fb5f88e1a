import xml.etree.ElementTree as ElementTree

import pytest
import torch

from cloudfit.plots import FAINT, INK, convergence_figure, histogram_figure


def histograms() -> tuple[torch.Tensor, torch.Tensor]:
    first = torch.zeros(3, 256, dtype=torch.float64)
    first[:, 100:110] = 0.1
    second = first.roll(20, dims=1)
    return first, second


def check_svg(svg: str) -> None:
    root = ElementTree.fromstring(svg.replace("xlink:href", "href"))
    assert root.tag.endswith("svg")
    assert "width" not in root.attrib, "the page decides the size"
    assert "height" not in root.attrib
    assert "viewBox" in root.attrib
    assert INK not in svg
    assert FAINT not in svg
    assert "currentColor" in svg
    assert "<script" not in svg


def test_histograms_are_drawn_for_each_channel() -> None:
    svg = histogram_figure(*histograms())
    check_svg(svg)
    assert all(f">{name}</text>" in svg for name in ("red", "green", "blue"))


def test_the_same_figures_give_the_same_bytes_and_others_do_not() -> None:
    first, second = histograms()
    assert histogram_figure(first, second) == histogram_figure(first, second)
    assert histogram_figure(first, second) != histogram_figure(first, first)


def test_a_saturated_photograph_and_an_empty_histogram_can_be_drawn() -> None:
    saturated = torch.zeros(3, 256, dtype=torch.float64)
    saturated[:, 255] = 1.0
    check_svg(histogram_figure(saturated, torch.zeros_like(saturated)))


@pytest.mark.parametrize("history", [[], [0.5], [None, 0.6, 0.5], [0.7] * 300, [0.0, 0.0]])
def test_any_history_can_be_drawn(history: list[float | None]) -> None:
    check_svg(convergence_figure(history, 0.1))
    check_svg(convergence_figure(history, None))


def test_the_floor_is_named() -> None:
    assert "floor 0.123" in convergence_figure([0.5, 0.4], 0.1234)
    assert "floor" not in convergence_figure([0.5, 0.4], None)
