"""The folder of one photograph: pictures, page and result, which appear together or not at all."""

import contextlib
import shutil
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cloudfit.cloud_mask import Label
from cloudfit.fit_types import PhotographFit, Picture
from cloudfit.photograph import Photograph
from cloudfit.report import photograph_page
from cloudfit.result import RESULT_NAME, read_result, write_result
from cloudfit.result_document import picture_name
from render.errors import ResultError
from render.image_files import write_exr, write_mask_png, write_png

PAGE_NAME = "index.html"

RESERVED_NAMES = frozenset({PAGE_NAME})
"""Names in the output folder that no photograph's folder may take."""

MASK_TINTS = {Label.CLOUD: (1.0, 0.42, 0.02), Label.SKY: (0.02, 0.22, 0.85), Label.OTHER: (0.05, 0.05, 0.05)}
"""Linear colours laid over the photograph."""

MASK_SHARES = {Label.CLOUD: 0.45, Label.SKY: 0.35, Label.OTHER: 0.8}

_ABANDONED_AFTER_SECONDS = 3600.0


def folder_names(photographs: list[Path]) -> dict[Path, str]:
    """Folder of each photograph: its stem, or its whole name where stems collide, numbered where names do too."""
    stems = [photograph.stem.casefold() for photograph in photographs]
    names: dict[Path, str] = {}
    taken: set[str] = set()
    for photograph in photographs:
        alone = stems.count(photograph.stem.casefold()) == 1 and photograph.stem.casefold() not in RESERVED_NAMES
        base = name = photograph.stem if alone else photograph.name
        number = 1
        while name.casefold() in taken:
            number += 1
            name = f"{base}-{number}"
        taken.add(name.casefold())
        names[photograph] = name
    return names


def write_fit(folder: Path, fit: PhotographFit, document: dict[str, Any], token: str) -> None:
    """Write pictures, page and result of a fit.

    Args:
        folder: of the photograph; its parent must exist.
        fit: what was found.
        document: from `describe_fit`; its `files` are filled in.
        token: marks the temporary folder as one of the caller's.

    Raises:
        ResultError: the folder's name is taken by a file.
    """
    with replaced_folder(folder, token) as temporary:
        document["files"] = _write_images(temporary, fit) | {"page": PAGE_NAME}
        best = fit.candidates[0]
        page = photograph_page(document, fit.histogram, best.histogram)
        (temporary / PAGE_NAME).write_text(page, encoding="utf-8")
        write_result(temporary / RESULT_NAME, document)


def write_reason(folder: Path, photograph: Photograph | None, document: dict[str, Any], token: str) -> None:
    """Write result and page of a photograph that was not fitted; arguments as for `write_fit`."""
    with replaced_folder(folder, token) as temporary:
        document["files"] = {"page": PAGE_NAME}
        if photograph is not None:
            write_png(temporary / "photograph.png", photograph.pixels)
            document["files"]["photograph"] = "photograph.png"
        (temporary / PAGE_NAME).write_text(photograph_page(document), encoding="utf-8")
        write_result(temporary / RESULT_NAME, document)


@contextlib.contextmanager
def replaced_folder(folder: Path, token: str) -> Iterator[Path]:
    """Temporary folder whose files move to `folder` when the block ends, `result.json` last; it vanishes in any case.

    A folder that is new appears by one renaming. In one that exists the old result is removed first and the files that it
    named are replaced; whatever else lies there is left alone.

    Args:
        folder: the final name; its parent must exist.
        token: marks the temporary folder as one of the caller's.

    Raises:
        ResultError: the name is taken by a file.
    """
    if folder.exists() and not folder.is_dir():
        raise ResultError(f"{folder}: expected a folder for the results, found a file; move it or choose another --out")
    temporary = folder.with_name(f".{folder.name}.{token}.part")
    _remove_leftovers(folder)
    shutil.rmtree(temporary, ignore_errors=True)  # of a writer with our token that was killed
    temporary.mkdir()
    try:
        yield temporary
        if folder.is_dir():
            _move_into(temporary, folder)
        else:
            temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def remove_temporary_folders(out: Path, token: str) -> None:
    """Remove what killed writers with this token left in the output folder."""
    for leftover in out.glob(f".*.{token}.part"):
        shutil.rmtree(leftover, ignore_errors=True)


def _move_into(temporary: Path, folder: Path) -> None:
    old: Mapping[str, str] = {}
    with contextlib.suppress(ResultError):
        old = read_result(folder)["files"]
    (folder / RESULT_NAME).unlink(missing_ok=True)
    new = sorted(temporary.iterdir(), key=lambda file: file.name == RESULT_NAME)
    for stale in set(old.values()) - {file.name for file in new}:
        (folder / stale).unlink(missing_ok=True)
    for file in new:
        file.replace(folder / file.name)


def _remove_leftovers(folder: Path) -> None:
    """A live writer changes its folder all the time; what has not changed for an hour belongs to one that was killed."""
    prefix = f".{folder.name}."
    for leftover in folder.parent.iterdir():
        if leftover.name.startswith(prefix) and leftover.name.endswith(".part"):
            with contextlib.suppress(OSError):
                if time.time() - leftover.stat().st_mtime > _ABANDONED_AFTER_SECONDS:
                    shutil.rmtree(leftover)


def _write_images(folder: Path, fit: PhotographFit) -> dict[str, str]:
    """Write all pictures; returns their names by what they show."""
    analysis = fit.analysis
    images = {
        "photograph": analysis.photograph.pixels,
        "mask_overlay": _mask_overlay(analysis.photograph.pixels, analysis.mask.labels),
        "sky": analysis.sky,
    }
    for rank, candidate in enumerate(fit.candidates, 1):
        images[Path(picture_name(rank)).stem] = candidate.picture.rgb
    best = fit.candidates[0].picture
    for layer in ("single", "multiple", "ambient"):
        images[f"layer_{layer}"] = getattr(best, layer)
    images["layer_sky"] = best.sky
    for name, image in images.items():
        write_png(folder / f"{name}.png", _displayable(image))
    write_mask_png(folder / "mask.png", analysis.mask.labels)
    write_exr(folder / "best.exr", picture_layers(best))
    write_exr(folder / "sky.exr", {"rgb": analysis.sky})
    return {name: f"{name}.png" for name in (*images, "mask")} | {"best_layers": "best.exr", "sky_linear": "sky.exr"}


def picture_layers(picture: Picture) -> dict[str, Tensor]:
    """Layers of an EXR file, linear; the four that are lit sum to `rgb`."""
    names = ("rgb", "single", "multiple", "ambient", "sky", "transmittance")
    return {name: getattr(picture, name) for name in names}


def _displayable(image: Tensor) -> Tensor:
    return image.nan_to_num(0.0, 1.0, 0.0)


def _mask_overlay(pixels: Tensor, labels: Tensor) -> Tensor:
    """The photograph in its own light, tinted by what each pixel was taken for, with the border of the clouds drawn."""
    tinted = pixels.clamp(0.0, 1.0).clone()
    for label, colour in MASK_TINTS.items():
        chosen = labels == label
        share = MASK_SHARES[label]
        tinted[chosen] = (1.0 - share) * tinted[chosen] + share * torch.tensor(colour) * (0.25 + 0.75 * tinted[chosen])
    cloud = (labels == Label.CLOUD).numpy()
    border = np.zeros_like(cloud)
    border[:-1] |= cloud[:-1] != cloud[1:]
    border[:, :-1] |= cloud[:, :-1] != cloud[:, 1:]
    tinted[torch.from_numpy(border)] = 1.0
    return tinted
