"""What the recovery benchmark shows: tables of losses and parameters, a summary, and a sheet of pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from rich.table import Table

from benchmarks.common import make_table, show, spread
from benchmarks.synthetic_photograph import Truth

SEARCHED = ("sunlight_intensity", "asymmetry", "extinction", "albedo", "ambient")

SHEET_WIDTH, SHEET_HEIGHT = 320, 240
PAIRS_PER_ROW = 2


@dataclass(frozen=True)
class FitRecord:
    """What one fit came to.

    Args:
        photograph: name.
        seed: of the search.
        searched_loss: of the best candidate on the stack.
        loss, floor, flat_floor, wasserstein: of the picture rendered by itself; the flat floor is that of a flat histogram.
        unit: found parameters in the unit cube, by name.
        parameters: found parameters in units, by name.
        optical_depth: found, of the densest view ray.
        air_depth: found.
        seconds: of the search and its picture.
        evaluations: of the search.
        picture: file.
    """

    photograph: str
    seed: int
    searched_loss: float
    loss: float
    floor: float
    flat_floor: float
    wasserstein: float
    unit: dict[str, float]
    parameters: dict[str, float]
    optical_depth: float
    air_depth: tuple[float, float, float]
    seconds: dict[str, float]
    evaluations: int
    picture: str


@dataclass(frozen=True)
class PhotographRecord:
    """One photograph and its truth.

    Args:
        name: of the photograph.
        truth: its parameters.
        unit: true parameters in the unit cube, by name.
        noise, noise_rms, samples: of the path tracing.
        cloud_pixels: number that count.
        loss_of_truth: of the true parameters on the stack, with the best air that the search tries.
        loss_with_true_air: the same with the true air: what noise of the photograph and errors of the stack leave.
    """

    name: str
    truth: Truth
    unit: dict[str, float]
    noise: float
    noise_rms: float
    samples: int
    cloud_pixels: int
    loss_of_truth: float
    loss_with_true_air: float


def summarise(fits: Sequence[FitRecord], photographs: Sequence[PhotographRecord]) -> dict[str, dict[str, float]]:
    """Spread of each measure over all fits."""
    truth = {photograph.name: photograph for photograph in photographs}
    first = {fit.photograph: fit for fit in fits}
    recovered = {
        f"error of {name}, share of its range": spread(abs(f.unit[name] - truth[f.photograph].unit[name]) for f in fits)
        for name in SEARCHED
    }
    return {
        "loss": spread(f.loss for f in fits),
        "loss / floor": spread(f.loss / f.floor for f in fits),
        "loss / flat floor": spread(f.loss / f.flat_floor for f in fits),
        "searched loss / floor": spread(f.searched_loss / f.floor for f in fits),
        "loss of the truth on the stack / floor": spread(p.loss_of_truth / first[p.name].floor for p in photographs),
        "loss of the truth with the true air / floor": spread(
            p.loss_with_true_air / first[p.name].floor for p in photographs
        ),
        "Wasserstein distance, grey levels": spread(f.wasserstein for f in fits),
        "search, seconds": spread(f.seconds["search"] for f in fits),
        "picture, seconds": spread(f.seconds["pictures"] for f in fits),
        **recovered,
    }


def summary_table(summary: dict[str, dict[str, float]]) -> Table:
    """Medians and quartiles over all fits."""
    rows = [(name, show(values), values["largest"]) for name, values in summary.items()]
    return make_table("All fits", ("measure", "median [quartiles]", "largest"), rows)


def loss_table(photographs: Sequence[PhotographRecord], fits: Sequence[FitRecord]) -> Table:
    """Losses of each photograph beside their floors."""
    rows = []
    for photograph in photographs:
        own = [fit for fit in fits if fit.photograph == photograph.name]
        rows.append(
            (
                photograph.name,
                f"{photograph.noise:.1%}, {photograph.noise_rms:.0%}",
                str(photograph.cloud_pixels),
                show(spread(fit.searched_loss for fit in own)),
                photograph.loss_of_truth,
                photograph.loss_with_true_air,
                show(spread(fit.loss for fit in own)),
                own[0].floor,
                own[0].flat_floor,
                show(spread(fit.loss / fit.floor for fit in own)),
                show(spread(fit.wasserstein for fit in own)),
            )
        )
    columns = (
        "photograph",
        "noise",
        "pixels",
        "searched",
        "truth",
        "true air",
        "loss",
        "floor",
        "flat",
        "loss / floor",
        "levels",
    )
    return make_table("Losses: median [quartiles] over the seeds", columns, rows)


def parameter_table(photographs: Sequence[PhotographRecord], fits: Sequence[FitRecord]) -> Table:
    """True parameters beside those that were found."""
    rows = []
    for photograph in photographs:
        own = [fit for fit in fits if fit.photograph == photograph.name]
        truth = photograph.truth
        found = [
            (truth.sunlight_intensity, [fit.parameters["sunlight_intensity"] for fit in own]),
            (truth.asymmetry, [fit.parameters["asymmetry"] for fit in own]),
            (truth.optical_depth, [fit.optical_depth for fit in own]),
            (truth.albedo, [fit.parameters["albedo"] for fit in own]),
            (truth.ambient, [fit.parameters["ambient"] for fit in own]),
            *((truth.air_depth[c], [fit.air_depth[c] for fit in own]) for c in range(3)),
        ]
        rows.append([photograph.name, *(f"{true:.2g}: {show(spread(values), 2)}" for true, values in found)])
    columns = ("photograph", "L_in", "g", "optical depth", "albedo", "ambient", "air red", "air green", "air blue")
    return make_table("Parameters: true value: median [quartiles] found", columns, rows)


def write_contact_sheet(folder: Path, photographs: Sequence[PhotographRecord], fits: Sequence[FitRecord]) -> Path:
    """Each photograph beside the best of its pictures, with the loss over its floor; returns the file."""
    pairs = []
    for photograph in photographs:
        best = min((fit for fit in fits if fit.photograph == photograph.name), key=lambda fit: fit.loss)
        truth = _labelled(folder / f"photograph-{photograph.name}.png", f"{photograph.name} true")
        found = _labelled(folder / best.picture, f"fit, loss {best.loss:.3f} = {best.loss / best.floor:.1f} floors")
        pairs.append(np.hstack([truth, found]))
    while len(pairs) % PAIRS_PER_ROW:
        pairs.append(np.zeros_like(pairs[0]))
    rows = [np.hstack(pairs[first : first + PAIRS_PER_ROW]) for first in range(0, len(pairs), PAIRS_PER_ROW)]
    path = folder / "contact.png"
    cv2.imwrite(str(path), np.vstack(rows))
    return path


def _labelled(path: Path, text: str) -> np.ndarray:
    """Picture of one size with a line of text."""
    image = cv2.resize(cv2.imread(str(path)), (SHEET_WIDTH, SHEET_HEIGHT), interpolation=cv2.INTER_AREA)
    return cv2.putText(
        image, text, (6, SHEET_HEIGHT - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA
    )
