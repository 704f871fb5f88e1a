"""How often does the automatic cloud mask agree with pixels that a person has labelled?

A folder of labels holds, for a photograph NAME.*, a grey PNG NAME_sparse.png or NAME.png: 0 unlabelled, 85 neither sky nor cloud, 170 clear
sky, 255 cloud. Balanced accuracy is the mean of the shares of cloud and of sky labels that are met.
"""

import argparse
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from benchmarks.common import SHARED, Outcome, make_table, scene_of, show, spread, stopwatch
from benchmarks.synthetic_photograph import MIDDLE, photograph_of_opacity
from cloudfit.cloud_mask import Label, detect_clouds, read_user_mask
from cloudfit.photograph import list_photographs, read_photograph
from render.errors import InputError


@dataclass(frozen=True)
class MaskRecord:
    """Agreement on one photograph; None where a label does not occur.

    Args:
        name: of the photograph.
        cloud_met: share of the cloud labels that the mask calls cloud.
        sky_met: share of the sky labels that the mask calls sky.
        sky_not_cloud: share of the sky labels that the mask does not call cloud.
        other_as_cloud: share of the labels of neither that the mask calls cloud.
        balanced_accuracy: mean of `cloud_met` and `sky_not_cloud`.
        seconds: of the mask.
    """

    name: str
    cloud_met: float | None
    sky_met: float | None
    sky_not_cloud: float | None
    other_as_cloud: float | None
    balanced_accuracy: float | None
    seconds: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    parser.add_argument("--photographs", type=Path, default=SHARED / "photos", help="folder")
    parser.add_argument("--masks", type=Path, default=SHARED / "masks", help="folder of labels")
    parser.set_defaults(volume=None)


def run(arguments: argparse.Namespace) -> Outcome:
    """Compare; a quick run labels a photograph that it renders itself."""
    with tempfile.TemporaryDirectory() as folder:
        if arguments.quick:
            pairs = [_render_pair(arguments, Path(folder))]
        else:
            pairs = find_pairs(arguments.photographs, arguments.masks)
        records = [compare(photograph, labels) for photograph, labels in pairs]
    columns = ("photograph", "cloud met", "sky met", "sky not cloud", "other as cloud", "balanced accuracy", "seconds")
    rows = [[cell if isinstance(cell, str) else _show(cell) for cell in asdict(r).values()] for r in records]
    accuracies = [record.balanced_accuracy for record in records if record.balanced_accuracy is not None]
    summary: dict[str, object] = {"photographs_with_both_labels": len(accuracies)}
    notes = ["labels keep clear of boundaries, so they are an easy test"]
    if accuracies:
        mean = sum(accuracies) / len(accuracies)
        summary |= {"mean_balanced_accuracy": mean, "balanced_accuracy": spread(accuracies)}
        notes.insert(0, f"mean balanced accuracy {mean:.3f}, median [quartiles] {show(spread(accuracies))}")
    values = {"summary": summary, "photographs": [asdict(record) for record in records]}
    return Outcome(values, (make_table("Automatic mask against labels", columns, rows),), tuple(notes))


def find_pairs(photographs: Path, masks: Path) -> list[tuple[Path, Path]]:
    """Photographs with the files of their labels.

    Raises:
        InputError: no photograph has labels.
    """
    by_name = {path.stem: path for path in list_photographs(photographs)}
    labels = {path.stem.removesuffix("_sparse"): path for path in sorted(masks.glob("*.png"))}
    pairs = [(by_name[name], path) for name, path in labels.items() if name in by_name]
    if not pairs:
        raise InputError(
            f"{masks}: expected labels of photographs in {photographs}, found none; pass --masks and --photographs"
        )
    return pairs


def compare(photograph: Path, labels: Path) -> MaskRecord:
    """Agreement on one photograph."""
    pixels = read_photograph(photograph).pixels
    with stopwatch() as seconds:
        mask = detect_clouds(pixels)
    height, width = pixels.shape[:2]
    label = read_user_mask(labels, (height, width))

    def share(of: Label, met: torch.Tensor) -> float | None:
        labelled = label == of
        return float(met[labelled].double().mean()) if bool(labelled.any()) else None

    cloud_met, not_cloud = share(Label.CLOUD, mask.cloud), share(Label.SKY, ~mask.cloud)
    both = None if cloud_met is None or not_cloud is None else 0.5 * (cloud_met + not_cloud)
    sky_met, other = share(Label.SKY, mask.sky), share(Label.OTHER, mask.cloud)
    return MaskRecord(photograph.stem, cloud_met, sky_met, not_cloud, other, both, seconds[0])


def _render_pair(arguments: argparse.Namespace, folder: Path) -> tuple[Path, Path]:
    scene, _ = scene_of(arguments, 96, 72)
    path = folder / "photographs" / "cumulus.png"
    path.parent.mkdir()
    photograph_of_opacity(scene, scene.camera, MIDDLE, path)
    return path, path.with_name("cumulus_mask.png")


def _show(share: float | None) -> str:
    return "" if share is None else f"{share:.3f}"
