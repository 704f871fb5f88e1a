"""What an image file says about itself: its format, whether it is whole, its curve and its orientation."""

import re
import struct
import zlib
from collections.abc import Iterator
from enum import Enum

import numpy as np

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"

# First bytes of the formats that can be decoded, so that a damaged image can be told from a file that is no image.
SIGNATURES: dict[str, re.Pattern[bytes]] = {
    name: re.compile(signature, re.DOTALL)
    for name, signature in {
        "JPEG": rb"\xff\xd8\xff",
        "PNG": re.escape(PNG_SIGNATURE),
        "TIFF": rb"II[*+]\x00|MM\x00[*+]",
        "WebP": rb"RIFF....WEBP",
        "BMP": rb"BM",
        "EXR": rb"\x76\x2f\x31\x01",
        "HDR": rb"#\?(RADIANCE|RGBE)",
        "JPEG 2000": rb"\x00\x00\x00\x0cjP  |\xff\x4f\xff\x51",
        "AVIF": rb"....ftypavi[fs]",
        "PNM": rb"P[1-7FfS]\s",
    }.items()
}

# gAMA holds 100000 / gamma of the encoding; 45455 is how writers state sRGB, 100000 is linear light.
PNG_GAMMA_LINEAR = 100000
PNG_GAMMA_TOLERANCE = 2000

EXIF_ORIENTATION_TAG = 0x0112


class Curve(Enum):
    """How the numbers of a file relate to light."""

    UNTAGGED = "untagged"
    SRGB = "srgb"
    LINEAR = "linear"


def image_format(data: bytes) -> str | None:
    """Name of the format that the first bytes announce, or None for a file that is no known image."""
    return next((name for name, signature in SIGNATURES.items() if signature.match(data)), None)


def png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Walk the chunks of a PNG as (type, contents).

    Raises:
        ValueError: the file ends before IEND, or a checksum does not match.
    """
    position = len(PNG_SIGNATURE)
    kind = b""
    while kind != b"IEND":
        if position + 12 > len(data):
            raise ValueError("it is truncated: the end marker IEND of a PNG is missing")
        length, kind = struct.unpack_from(">I4s", data, position)
        body_end = position + 8 + length
        if body_end + 4 > len(data):
            raise ValueError(f"it is truncated: it ends inside the {kind.decode('latin-1')} chunk of a PNG")
        body = memoryview(data)[position + 8 : body_end]
        (checksum,) = struct.unpack_from(">I", data, body_end)
        if zlib.crc32(body, zlib.crc32(kind)) != checksum:
            raise ValueError(f"it is damaged: wrong checksum in the {kind.decode('latin-1')} chunk of a PNG")
        yield kind, bytes(body) if kind != b"IDAT" else b""
        position = body_end + 4


def _png_curve(data: bytes) -> Curve:
    """Curve that a PNG states, by the precedence of the PNG specification: cICP, iCCP, sRGB, then gAMA."""
    chunks = dict(png_chunks(data))
    if b"cICP" in chunks:
        # Second byte: transfer function of ITU-T H.273, where 8 is linear.
        return Curve.LINEAR if chunks[b"cICP"][1:2] == b"\x08" else Curve.SRGB
    if b"iCCP" in chunks or b"sRGB" in chunks:
        return Curve.SRGB
    if b"gAMA" in chunks:
        gamma = struct.unpack(">I", chunks[b"gAMA"][:4])[0]
        return Curve.LINEAR if abs(gamma - PNG_GAMMA_LINEAR) < PNG_GAMMA_TOLERANCE else Curve.SRGB
    return Curve.UNTAGGED


def stated_curve(data: bytes, has_icc_profile: bool) -> Curve:
    """Curve that the file states; an embedded ICC profile counts as sRGB, as photographs carry display profiles.

    Raises:
        ValueError: a PNG that is truncated or damaged.
    """
    if image_format(data) == "PNG":
        return _png_curve(data)
    return Curve.SRGB if has_icc_profile else Curve.UNTAGGED


def check_jpeg_end(data: bytes) -> None:
    """Refuse a JPEG whose last scan has no end marker: decoders fill the missing part with grey.

    Raises:
        ValueError: no EOI marker follows the last start of scan.
    """
    last_scan = data.rfind(b"\xff\xda")
    # Cameras append previews and video behind the marker, so it need not be the last two bytes.
    if last_scan < 0 or re.search(rb"\xff\xd9", data[last_scan:]) is None:
        raise ValueError("it is truncated: the end marker of a JPEG is missing")


def add_png_curve(data: bytes, curve: Curve) -> bytes:
    """Insert the chunk that states a PNG's curve (sRGB, or gAMA 1.0 for linear light) right behind its header."""
    kind, body = (b"sRGB", b"\x00") if curve is Curve.SRGB else (b"gAMA", struct.pack(">I", PNG_GAMMA_LINEAR))
    chunk = struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    header_end = len(PNG_SIGNATURE) + 12 + struct.unpack_from(">I", data, len(PNG_SIGNATURE))[0]
    return data[:header_end] + chunk + data[header_end:]


def exif_orientation(exif: bytes) -> int:
    """Orientation 1..8 of an EXIF block; 1 (as it stands) where the block is absent, damaged or silent."""
    start = max(exif.find(b"II*\x00"), exif.find(b"MM\x00*"))
    if start < 0:
        return 1
    tiff = exif[start:]
    order = "<" if tiff.startswith(b"II") else ">"
    try:
        (directory,) = struct.unpack_from(order + "I", tiff, 4)
        (entries,) = struct.unpack_from(order + "H", tiff, directory)
        for entry in range(entries):
            tag, _, _, value = struct.unpack_from(order + "HHIH", tiff, directory + 2 + 12 * entry)
            if tag == EXIF_ORIENTATION_TAG:
                return value if 1 <= value <= 8 else 1
    except struct.error:
        return 1
    return 1


def apply_orientation(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Turn stored pixels (height, width, ...) the way the EXIF orientation asks for (EXIF 2.3, tag 274)."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels)
