"""Pages that show a result: one for each photograph, and one for the whole folder."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from torch import Tensor, tensor

from cloudfit.plots import convergence_figure, histogram_figure
from cloudfit.result import read_result
from render.atomic_write import atomic_path
from render.colour import linear_to_srgb
from render.errors import ResultError

UNITS = {"1": "", "1/m": "m⁻¹"}
"""How units are written on a page."""

NAMES = {
    "sunlight_intensity": "sunlight intensity",
    "ambient": "ambient light",
    "ambient_red": "ambient light, red",
    "ambient_green": "ambient light, green",
    "ambient_blue": "ambient light, blue",
}

STATUS_WORDS = {"done": "fitted", "failed": "failed", "no_cloud": "no cloud"}


def photograph_page(
    document: Mapping[str, Any], photograph: Tensor | None = None, picture: Tensor | None = None
) -> str:
    """Page of one photograph.

    Args:
        document: as in its `result.json`.
        photograph: histogram of its cloud pixels `(channel, bin)`; None if it was not fitted.
        picture: histogram of the best picture.

    Returns:
        HTML that needs nothing but the pictures beside it.
    """
    figures: dict[str, str] = {}
    if photograph is not None and picture is not None:
        figures["histogram"] = histogram_figure(photograph, picture)
        search, best = document["search"], document["candidates"][0]
        figures["convergence"] = convergence_figure(search["history"], best["floor"])
    template = page_environment().get_template("photograph.html")
    return template.render(result=document, figures=figures, title=document["photograph"]["file"])


def folder_page(entries: Sequence[tuple[str, Mapping[str, Any]]], unreadable: Sequence[str] = ()) -> str:
    """Page of a whole output folder.

    Args:
        entries: folder names and documents.
        unreadable: sentences about results that cannot be read.
    """
    counts = {status: sum(document["status"] == status for _, document in entries) for status in STATUS_WORDS}
    template = page_environment().get_template("index.html")
    return template.render(entries=entries, unreadable=unreadable, counts=counts, title="Clouds fitted to photographs")


def write_folder_page(out: Path) -> Path:
    """Write `index.html` of an output folder from the results that lie in it; returns its path."""
    entries, unreadable = [], []
    for path in sorted(out.glob("*/result.json")):
        try:
            entries.append((path.parent.name, read_result(path)))
        except ResultError as error:
            unreadable.append(str(error))
    page = out / "index.html"
    with atomic_path(page) as temporary:
        temporary.write_text(folder_page(entries, unreadable), encoding="utf-8")
    return page


def page_environment() -> Environment:
    """Templates of the pages, with the filters that write numbers, durations, colours and units."""
    environment = Environment(
        loader=PackageLoader("cloudfit"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "number": write_number,
        "seconds": write_seconds,
        "swatch": write_colour,
        "unit": lambda unit: UNITS.get(unit, unit),
        "parameter": lambda name: NAMES.get(name, name.replace("_", " ")),
        "status": lambda status: STATUS_WORDS[status],
    }
    return environment


def write_number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, without an exponent where it is short enough without."""
    if value is None:
        return "–"
    if value == 0:
        return "0"
    if 1e-4 <= abs(value) < 1e6:
        text = f"{value:.{digits}g}"
        return f"{value:.0f}" if "e" in text else text
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa} · 10{str(int(exponent)).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"


def write_seconds(value: float) -> str:
    """A duration as a person says it."""
    if value < 60:
        return f"{value:.1f} s" if value < 10 else f"{value:.0f} s"
    return f"{int(value) // 60} min {int(value) % 60} s"


def write_colour(linear: Sequence[float]) -> str:
    """Linear light as the colour that a page shows."""
    encoded = linear_to_srgb(tensor([float(value) for value in linear]).clamp(0.0, 1.0))
    return "#" + "".join(f"{round(255 * value):02x}" for value in encoded.tolist())
