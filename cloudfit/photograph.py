"""Photographs as the fit sees them: linear light, exposed so that 1.0 is display white, reduced to a working size."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from render.colour import luminance
from render.errors import PhotographError
from render.image_files import IMAGE_SUFFIXES, read_image

DEFAULT_MAX_SIDE = 1024

# A radiance image is exposed so that this share of its pixels stays below display white. The sun and its aureole cover
# about a hundredth of a panorama; sunlit cloud covers more, so it lands just below white, as a photographer exposes it.
EXPOSED_SHARE = 0.98

# Pixels with less coverage than this are no part of the picture.
TRANSPARENT_BELOW = 0.5


@dataclass(frozen=True)
class Photograph:
    """A photograph ready for analysis.

    Attributes:
        path: the file it came from.
        pixels: (height, width, channel) linear light [1], float32, display white is 1; an HDR sun exceeds it.
        original_size: (height, width) of the file [pixel].
        bit_depth: bits per channel of the file: 8, 16 or 32.
        exposure: factor that was applied to the radiance of the file [1]; 1 for 8 and 16 bits.
        sha256: hexadecimal digest of the file's bytes.
        opaque: (height, width) bool, False where the file is transparent and shows nothing.
    """

    path: Path
    pixels: Tensor
    original_size: tuple[int, int]
    bit_depth: int
    exposure: float
    sha256: str
    opaque: Tensor


def read_photograph(path: Path | str, max_side: int | None = DEFAULT_MAX_SIDE) -> Photograph:
    """Read and expose a photograph.

    Args:
        path: any file that `read_image` reads.
        max_side: longest side to work at [pixel]; None keeps the size of the file.

    Returns:
        The photograph.

    Raises:
        PhotographError: the file cannot be read as a photograph; the sentence names it and the reason.
    """
    path = Path(path)
    image = read_image(path, max_side)
    opaque = torch.ones(image.pixels.shape[:2], dtype=torch.bool)
    if image.alpha is not None:
        opaque = image.alpha >= TRANSPARENT_BELOW
        if not opaque.any():
            raise PhotographError(f"{path}: expected a picture, got one that is transparent everywhere")
    exposure = radiance_exposure(image.pixels[opaque]) if image.linear_source else 1.0
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return Photograph(path, image.pixels * exposure, image.original_size, image.bit_depth, exposure, digest, opaque)


def radiance_exposure(pixels: Tensor) -> float:
    """Factor that brings ordinary sky and cloud into the display range: 1 / (luminance that `EXPOSED_SHARE` stay below).

    Args:
        pixels: (pixel, channel) radiance in any scale, at least 0.

    Returns:
        The factor [1]; 1 for a black image.
    """
    values = luminance(pixels).flatten()
    rank = max(1, round(EXPOSED_SHARE * values.numel()))
    white = float(values.kthvalue(rank).values)
    if white == 0.0:
        white = float(values.max())
    return 1.0 / white if white > 0.0 else 1.0


def list_photographs(paths: Path | str | Iterable[Path | str]) -> list[Path]:
    """Image files named by files and folders, sorted, each once; a folder is not searched deeper.

    A file that is named itself is listed whatever its suffix, so that its error can be reported.

    Raises:
        PhotographError: a path does not exist, or a folder holds no image.
    """
    named = [paths] if isinstance(paths, Path | str) else list(paths)
    found: set[Path] = set()
    for path in map(Path, named):
        if path.is_dir():
            inside = [p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and _is_visible_file(p)]
            if not inside:
                raise PhotographError(f"{path}: expected a folder with photographs, found no image file in it")
            found.update(inside)
        elif path.exists():
            found.add(path)
        else:
            raise PhotographError(f"{path}: no such file or folder; check the name")
    return sorted(found)


def _is_visible_file(path: Path) -> bool:
    return path.is_file() and not path.name.startswith(".")
