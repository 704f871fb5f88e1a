"""Image files in and out: whatever OpenCV decodes, Radiance HDR and OpenEXR, as linear light with row 0 on top."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import torch
from torch import Tensor

from render.atomic_write import atomic_path
from render.colour import DISPLAY_CURVES, srgb_to_linear
from render.errors import PhotographError
from render.image_containers import (
    Curve,
    add_png_curve,
    apply_orientation,
    check_jpeg_end,
    exif_orientation,
    image_format,
    stated_curve,
)

# File names that a folder of photographs is searched for.
LOW_RANGE_SUFFIXES = (".jpg", ".jpeg", ".jpe", ".png", ".tif", ".tiff", ".bmp", ".dib", ".webp", ".avif", ".jp2")
PORTABLE_SUFFIXES = (".pbm", ".pgm", ".ppm", ".pnm")
RADIANCE_SUFFIXES = (".exr", ".hdr", ".pic")
IMAGE_SUFFIXES = frozenset((*LOW_RANGE_SUFFIXES, *PORTABLE_SUFFIXES, *RADIANCE_SUFFIXES))


@dataclass(frozen=True)
class ImageFile:
    """A decoded image.

    Attributes:
        pixels: (height, width, channel) linear light [1], float32; display white is 1 unless `linear_source`.
        alpha: (height, width) coverage 0..1, or None where the file has none; the pixels are not multiplied by it.
        bit_depth: bits per channel in the file: 8, 16 or 32.
        linear_source: the file holds radiance in its own scale (EXR, HDR, floating-point TIFF).
        original_size: (height, width) of the file [pixel], before it was reduced.
    """

    pixels: Tensor
    alpha: Tensor | None
    bit_depth: int
    linear_source: bool
    original_size: tuple[int, int]


def read_image(path: Path | str, max_side: int | None = None) -> ImageFile:
    """Decode an image file to linear light.

    8-bit files are decoded by the sRGB curve; 16-bit files are linear unless tagged (PNG cICP, iCCP, sRGB or gAMA; an
    embedded ICC profile); EXR, HDR and floating-point TIFF are linear. The EXIF orientation is applied.

    Args:
        path: the file.
        max_side: longest side of the result [pixel]; a larger image is reduced by area averaging of the stored numbers,
            before they become floats, so that 100 megapixels need no more memory than their integers.

    Returns:
        The image.

    Raises:
        PhotographError: the file is missing, a directory, empty, truncated, no image, or holds NaN, infinite or
            negative radiance.
    """
    path = Path(path)
    data = _read_bytes(path)
    kind = image_format(data)
    if kind == "EXR":
        stored, curve, orientation = _decode_exr(path), Curve.LINEAR, 1
    else:
        stored, curve, orientation = _decode(path, data, kind)
    if stored.dtype == np.float32:
        _check_radiance(path, stored)
    height, width = stored.shape[:2]
    stored = apply_orientation(_reduce(stored, max_side), orientation)
    original_size = (width, height) if orientation >= 5 else (height, width)
    return _to_linear(path, stored, curve, original_size)


def _read_bytes(path: Path) -> bytes:
    """Contents of the file, or the reason why there are none."""
    if path.is_dir():
        raise PhotographError(f"{path}: expected an image file, this is a directory; name the files or use a batch")
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise PhotographError(f"{path}: no such file; check the name") from None
    except OSError as error:
        raise PhotographError(f"{path}: cannot be read ({error.strerror})") from error
    if not data:
        raise PhotographError(f"{path}: the file is empty (zero bytes); copy it again from its source")
    return data


@contextmanager
def _silent_opencv() -> Iterator[None]:
    """Keep OpenCV from printing what becomes an exception anyway."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _decode(path: Path, data: bytes, kind: str | None) -> tuple[np.ndarray, Curve, int]:
    """Stored numbers (height, width[, channel]) in OpenCV's channel order, their curve, and the EXIF orientation."""
    if kind is None:
        raise PhotographError(
            f"{path}: not an image that can be decoded (expected JPEG, PNG, TIFF, WebP, BMP, EXR or HDR)"
        )
    try:
        if kind == "JPEG":
            check_jpeg_end(data)
        stated_curve(data, has_icc_profile=False)
        with _silent_opencv():
            stored, types, blocks = cv2.imdecodeWithMetadata(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except ValueError as error:
        raise PhotographError(f"{path}: {error}; copy it again from its source") from error
    except cv2.error as error:
        raise PhotographError(f"{path}: starts like a {kind} file but OpenCV refuses it ({error.err})") from error
    if stored is None:
        raise PhotographError(f"{path}: starts like a {kind} file but is truncated or damaged; copy it again")
    metadata = dict(zip(types, blocks, strict=True))
    curve = stated_curve(data, has_icc_profile=cv2.IMAGE_METADATA_ICCP in metadata)
    exif = metadata.get(cv2.IMAGE_METADATA_EXIF)
    orientation = 1 if exif is None else exif_orientation(np.ravel(exif).astype(np.uint8).tobytes())
    if stored.dtype == np.float64:
        stored = stored.astype(np.float32)
    return stored, Curve.LINEAR if stored.dtype == np.float32 else curve, orientation


def _exr_channels(path: Path) -> dict[str, np.ndarray]:
    """Channels of the first part of an EXR file by name, float32."""
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.asarray(c.pixels, np.float32) for name, c in file.parts[0].channels.items()}
    except Exception as error:  # OpenEXR raises RuntimeError, ValueError or TypeError, depending on where it stumbles
        raise PhotographError(f"{path}: starts like an EXR file but is truncated or damaged ({error})") from error
    if len({c.shape for c in channels.values()}) != 1:
        raise PhotographError(f"{path}: expected EXR channels of one size, got subsampled ones; save it as RGB")
    return channels


def _decode_exr(path: Path) -> np.ndarray:
    """Radiance of an EXR file as (height, width, 3 or 4) in OpenCV's channel order, or (height, width) grey."""
    channels = _exr_channels(path)
    if {"R", "G", "B"} <= channels.keys():
        names = "BGRA" if "A" in channels else "BGR"
        return np.stack([channels[name] for name in names], axis=-1)
    if "Y" in channels:
        return channels["Y"]
    raise PhotographError(f"{path}: expected EXR channels R, G, B or Y, got {', '.join(sorted(channels))}")


def _check_radiance(path: Path, stored: np.ndarray) -> None:
    """Refuse values that are no radiance: NaN, infinite or negative."""
    light = stored[..., :3] if stored.ndim == 3 else stored
    bad = {
        "NaN": np.isnan(light).sum(),
        "infinite": np.isinf(light).sum(),
        "negative": (light < 0.0).sum() - np.isneginf(light).sum(),
    }
    found = [f"{count} {name}" for name, count in bad.items() if count]
    if found:
        raise PhotographError(f"{path}: expected finite radiance of at least 0, got {', '.join(found)} values")


def _reduce(stored: np.ndarray, max_side: int | None) -> np.ndarray:
    """Reduce the longest side to `max_side` by area averaging; smaller images stay as they are."""
    height, width = stored.shape[:2]
    longest = max(height, width)
    if max_side is None or longest <= max_side:
        return stored
    size = (max(1, round(width * max_side / longest)), max(1, round(height * max_side / longest)))
    return cv2.resize(stored, size, interpolation=cv2.INTER_AREA)


def _to_linear(path: Path, stored: np.ndarray, curve: Curve, original_size: tuple[int, int]) -> ImageFile:
    """Stored numbers to linear RGB."""
    if stored.dtype not in (np.uint8, np.uint16, np.float32):
        raise PhotographError(f"{path}: expected 8-bit, 16-bit or floating-point channels, got {stored.dtype}")
    channels = 1 if stored.ndim == 2 else stored.shape[2]
    if channels not in (1, 3, 4):
        raise PhotographError(f"{path}: expected a grey, RGB or RGBA image, got {channels} channels")
    encoded = curve is Curve.SRGB or (curve is Curve.UNTAGGED and stored.dtype == np.uint8)
    light = stored if stored.ndim == 3 else stored[..., None]
    colours = torch.from_numpy(np.ascontiguousarray(light[..., [2, 1, 0] if channels > 1 else [0, 0, 0]]))
    linear_source = stored.dtype == np.float32
    full_scale = 1.0 if linear_source else float(np.iinfo(stored.dtype).max)
    return ImageFile(
        pixels=colours if linear_source else _light_table(stored.dtype, encoded)[colours.to(torch.int64)],
        alpha=torch.from_numpy(light[..., 3] / np.float32(full_scale)).clamp(0.0, 1.0) if channels == 4 else None,
        bit_depth=8 * stored.dtype.itemsize,
        linear_source=linear_source,
        original_size=original_size,
    )


def _light_table(dtype: np.dtype, encoded: bool) -> Tensor:
    """Linear light of every integer of the type; from a table, equal numbers become equal light to the last bit."""
    count = np.iinfo(dtype).max + 1
    values = torch.arange(count, dtype=torch.float32) / (count - 1)
    return srgb_to_linear(values[:, None].expand(-1, 3))[:, 0] if encoded else values


def write_png(path: Path | str, linear: Tensor, display_curve: str = "srgb", bits: int = 8) -> None:
    """Write linear light as a PNG that states its curve; values outside 0..1 are clipped.

    Args:
        path: the file; written under a temporary name, then renamed.
        linear: (height, width, channel) linear light [1].
        display_curve: a name of `DISPLAY_CURVES`.
        bits: bits per channel, 8 or 16.

    Raises:
        ValueError: another shape, another number of bits, or a value that is NaN.
    """
    if linear.ndim != 3 or linear.shape[-1] != 3 or bits not in (8, 16):
        raise ValueError(f"expected (height, width, 3) and 8 or 16 bits, got {tuple(linear.shape)} and {bits}")
    if torch.isnan(linear).any():
        raise ValueError(f"{path}: the image to be written holds NaN")
    encoded = DISPLAY_CURVES[display_curve](linear.detach().cpu().clamp(0.0, 1.0)).numpy()
    integers = np.rint(encoded[..., ::-1] * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
    data = cv2.imencode(".png", integers)[1].tobytes()
    with atomic_path(Path(path)) as temporary:
        temporary.write_bytes(add_png_curve(data, Curve.SRGB if display_curve == "srgb" else Curve.LINEAR))


def write_mask_png(path: Path | str, mask: Tensor | np.ndarray) -> None:
    """Write a mask (height, width) as a grey PNG: bool as 0 and 255, uint8 as it stands."""
    values = mask.detach().cpu().numpy() if isinstance(mask, Tensor) else np.asarray(mask)
    if values.ndim != 2 or values.dtype not in (np.bool_, np.uint8):
        raise ValueError(f"expected a bool or uint8 mask (height, width), got {values.dtype} {values.shape}")
    values = values.astype(np.uint8) * 255 if values.dtype == np.bool_ else values
    with atomic_path(Path(path)) as temporary:
        temporary.write_bytes(cv2.imencode(".png", values)[1].tobytes())


def read_mask_png(path: Path | str) -> np.ndarray:
    """Read the stored grey numbers of an 8-bit mask (height, width), uint8; the inverse of `write_mask_png`.

    Raises:
        PhotographError: the file is missing, truncated, no image, coloured, or not of 8 bits.
    """
    path = Path(path)
    data = _read_bytes(path)
    stored, _, orientation = _decode(path, data, image_format(data))
    if stored.dtype != np.uint8:
        raise PhotographError(f"{path}: expected a mask of 8 bits per channel, got {stored.dtype}")
    if stored.ndim == 3:
        if (stored[..., :3] != stored[..., :1]).any():
            raise PhotographError(f"{path}: expected a grey mask, got a coloured image; save it in grey levels")
        stored = stored[..., 0]
    return apply_orientation(stored, orientation)


def write_exr(path: Path | str, layers: Mapping[str, Tensor]) -> None:
    """Write float32 layers, each (height, width) or (height, width, channel), into one EXR file.

    Layer "rgb" becomes the channels R, G, B that every viewer shows; another layer X becomes X.R, X.G, X.B, or X.Y.
    """
    channels: dict[str, np.ndarray] = {}
    for name, layer in layers.items():
        values = np.ascontiguousarray(layer.detach().cpu().to(torch.float32).numpy())
        if values.ndim == 2 and name != "rgb":
            channels[f"{name}.Y"] = values
        elif values.ndim == 3 and values.shape[2] == 3:
            prefix = "" if name == "rgb" else f"{name}."
            channels |= {f"{prefix}{c}": np.ascontiguousarray(values[..., i]) for i, c in enumerate("RGB")}
        else:
            raise ValueError(f"expected layer {name} as (height, width) or (height, width, 3), got {values.shape}")
    sizes = {values.shape for values in channels.values()}
    if len(sizes) != 1:
        raise ValueError(f"expected at least one layer and all of one size, got sizes {sorted(sizes)}")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with atomic_path(Path(path)) as temporary, OpenEXR.File(header, channels) as file:
        file.write(str(temporary))


def read_exr_layers(path: Path | str) -> dict[str, Tensor]:
    """Read the layers that `write_exr` wrote, by name.

    Raises:
        PhotographError: the file is missing, truncated or no EXR file.
    """
    path = Path(path)
    if image_format(_read_bytes(path)) != "EXR":
        raise PhotographError(f"{path}: expected an EXR file, its first bytes are not those of one")
    channels = _exr_channels(path)
    layers: dict[str, Tensor] = {}
    for prefix in dict.fromkeys(name.rpartition(".")[0] for name in channels):
        names = [f"{prefix}.{c}" if prefix else c for c in "RGB"]
        if all(name in channels for name in names):
            layers[prefix or "rgb"] = torch.from_numpy(np.stack([channels[name] for name in names], axis=-1))
        elif f"{prefix}.Y" in channels:
            layers[prefix] = torch.from_numpy(channels[f"{prefix}.Y"])
    return layers
