import html.parser
from pathlib import Path
from typing import Any

import pytest

from cloudfit.photograph import read_photograph
from cloudfit.report import (
    folder_page,
    photograph_page,
    write_colour,
    write_folder_page,
    write_number,
    write_seconds,
)
from cloudfit.result import write_result
from cloudfit.result_document import describe_fit, describe_reason
from tests.support.hand_made_fit import make_analysis, make_circumstances, make_fit, make_space, write_photograph

VOID = {"meta", "img", "link", "br", "hr", "input"}


class Balance(html.parser.HTMLParser):
    """Checks that tags close, and collects what the page would load."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.sources += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag


def check_page(page: str) -> list[str]:
    balance = Balance()
    balance.feed(page)
    assert not balance.open
    assert "<script" not in page
    assert not [source for source in balance.sources if "//" in source], "nothing from elsewhere"
    return balance.sources


@pytest.fixture
def document(tmp_path: Path) -> dict[str, Any]:
    photograph = write_photograph(tmp_path / "a <b> & c.png")
    fit = make_fit(make_analysis(read_photograph(photograph)))
    document = describe_fit(fit, make_space(), make_circumstances(photograph))
    names = ("photograph", "best", "candidate_2", "mask_overlay", "sky")
    layers = ("layer_single", "layer_multiple", "layer_ambient", "layer_sky")
    document["files"] = {name: f"{name}.png" for name in (*names, *layers)} | {"best_layers": "best.exr"}
    return document


def page_of(document: dict[str, Any], tmp_path: Path) -> str:
    fit = make_fit(make_analysis(read_photograph(next(tmp_path.glob("*.png")))))
    return photograph_page(document, fit.histogram, fit.candidates[0].histogram)


def test_a_page_shows_what_was_found_and_loads_nothing_else(tmp_path: Path, document: dict[str, Any]) -> None:
    page = page_of(document, tmp_path)
    sources = check_page(page)
    assert {"photograph.png", "best.png", "candidate_2.png", "mask_overlay.png", "sky.png"} <= set(sources)
    assert "m⁻¹" in page
    assert page.count("<svg") == 2
    assert "at its bound" in page, "the albedo is"
    assert "At the floor" not in page


def test_names_and_warnings_are_escaped(tmp_path: Path, document: dict[str, Any]) -> None:
    page = page_of(document, tmp_path)
    assert "a &lt;b&gt; &amp; c.png" in page
    assert "<b> &" not in page
    assert "&lt;with&gt; signs &amp; all" in page


def test_a_loss_near_its_floor_is_said_to_be(tmp_path: Path, document: dict[str, Any]) -> None:
    document["candidates"][0]["near_floor"] = True
    assert "At the floor" in page_of(document, tmp_path)


def test_an_interrupted_search_is_said_to_be(tmp_path: Path, document: dict[str, Any]) -> None:
    assert "Interrupted" not in page_of(document, tmp_path)
    document["interrupted"] = True
    assert "Interrupted" in page_of(document, tmp_path)


def test_what_the_photograph_determines_is_shown(tmp_path: Path, document: dict[str, Any]) -> None:
    page = page_of(document, tmp_path)
    assert "42 of the parameter sets tried" in page
    assert page.count(">determined by the photograph<") == 4
    assert page.count(">not determined<") == 1
    document["determination"] = None
    assert "What the photograph determines" not in page_of(document, tmp_path)


def test_the_loss_has_its_name_where_it_is_another(tmp_path: Path, document: dict[str, Any]) -> None:
    assert "loss, 0 to 2" in page_of(document, tmp_path)
    document["options"]["loss"] = "squared_difference"
    for candidate in document["candidates"]:
        candidate |= {"floor": 0.0, "near_floor": False}
    page = page_of(document, tmp_path)
    check_page(page)
    assert "loss, 0 to 2" not in page
    assert "loss (squared difference)" in page
    assert "times the floor" not in page
    assert "squared difference 0.600" in folder_page([("folder", document)])
    del document["options"]["loss"], document["determination"]
    check_page(folder_page([("written before there was a choice", document)]))


def test_missing_losses_do_not_break_the_pages(tmp_path: Path, document: dict[str, Any]) -> None:
    for candidate in document["candidates"]:
        candidate |= {"loss": None, "floor": None, "wasserstein_levels": None, "image_error": None}
    check_page(page_of(document, tmp_path))
    check_page(folder_page([("folder", document)]))


@pytest.mark.parametrize(
    ("status", "words"), [("failed", "could not be fitted"), ("no_cloud", "shows no cloud that could be fitted")]
)
def test_a_photograph_that_was_not_fitted_has_a_page_with_the_reason(tmp_path: Path, status: str, words: str) -> None:
    document = describe_reason(status, "because <so>", make_circumstances(tmp_path / "photo.png"))
    page = photograph_page(document)
    check_page(page)
    assert words in page
    assert "because &lt;so&gt;" in page


def test_the_folder_page_links_every_photograph(tmp_path: Path, document: dict[str, Any]) -> None:
    failed = describe_reason("failed", "it is empty", make_circumstances(tmp_path / "photo.png"))
    page = folder_page([("sky & sea", document), ("broken", failed)], ["another cannot be read"])
    sources = check_page(page)
    assert "sky%20%26%20sea/index.html" in sources
    assert "broken/index.html" in sources
    assert "it is empty" in page
    assert "another cannot be read" in page
    assert "2 photographs: 1 fitted, 1 failed" in page


def test_an_empty_folder_has_a_page() -> None:
    check_page(folder_page([]))


def test_the_folder_page_is_made_of_the_results_that_lie_there(tmp_path: Path, document: dict[str, Any]) -> None:
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        write_result(tmp_path / name / "result.json", document)
    (tmp_path / "second" / "result.json").write_text("{")
    page = write_folder_page(tmp_path).read_text(encoding="utf-8")
    assert "first/index.html" in page
    assert "second/index.html" not in page
    assert "truncated, damaged or not JSON" in page


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (None, "–"),
        (0.123456, "0.123"),
        (1234.5, "1234"),
        (123456.0, "123456"),
        (1.5e-7, "1.50 · 10⁻⁷"),
        (-2.0e9, "-2.00 · 10⁹"),
    ],
)
def test_numbers_are_short(value: float | None, text: str) -> None:
    assert write_number(value) == text


def test_durations_are_as_a_person_says_them() -> None:
    assert [write_seconds(value) for value in (1.26, 35.2, 61.0)] == ["1.3 s", "35 s", "1 min 1 s"]


def test_colours_pass_through_the_display_curve() -> None:
    assert write_colour([1.0, 0.0, 0.214]) == "#ff007f"
    assert write_colour([2.0, -1.0, 0.0]) == "#ff0000"
