import struct

import cv2
import numpy as np
import pytest

from render.image_containers import (
    Curve,
    add_png_curve,
    apply_orientation,
    check_jpeg_end,
    exif_orientation,
    image_format,
    png_chunks,
    stated_curve,
)


def png(bits: int = 8) -> bytes:
    values = np.arange(48).reshape(4, 4, 3).astype(np.uint8 if bits == 8 else np.uint16)
    return cv2.imencode(".png", values)[1].tobytes()


def jpeg() -> bytes:
    return cv2.imencode(".jpg", np.full((16, 16, 3), 90, np.uint8))[1].tobytes()


def exif(orientation: int, order: str = "<") -> bytes:
    mark = b"II*\x00" if order == "<" else b"MM\x00*"
    entry = struct.pack(order + "HHIHH", 0x0112, 3, 1, orientation, 0)
    return b"Exif\x00\x00" + mark + struct.pack(order + "IH", 8, 1) + entry + struct.pack(order + "I", 0)


def test_formats_are_told_by_their_first_bytes():
    assert image_format(png()) == "PNG"
    assert image_format(jpeg()) == "JPEG"
    assert image_format(b"#?RADIANCE\n") == "HDR"
    assert image_format(b"\x76\x2f\x31\x01") == "EXR"
    assert image_format(b"dear diary") is None


def test_a_whole_png_ends_with_its_end_marker():
    assert [kind for kind, _ in png_chunks(png())][-1] == b"IEND"


@pytest.mark.parametrize("kept", [20, 40, -12, -1])
def test_a_truncated_png_is_refused(kept):
    with pytest.raises(ValueError, match="truncated"):
        list(png_chunks(png()[:kept]))


def test_a_png_with_a_flipped_bit_is_refused():
    data = bytearray(png())
    data[45] ^= 1
    with pytest.raises(ValueError, match="damaged"):
        list(png_chunks(bytes(data)))


def test_a_jpeg_needs_its_end_marker_but_may_carry_more_behind_it():
    check_jpeg_end(jpeg())
    check_jpeg_end(jpeg() + b"motion video")
    with pytest.raises(ValueError, match="truncated"):
        check_jpeg_end(jpeg()[:-2])


@pytest.mark.parametrize("curve", [Curve.SRGB, Curve.LINEAR])
def test_a_curve_written_into_a_png_is_read_back(curve):
    assert stated_curve(png(), has_icc_profile=False) is Curve.UNTAGGED
    assert stated_curve(add_png_curve(png(), curve), has_icc_profile=False) is curve


def test_an_icc_profile_counts_as_srgb():
    assert stated_curve(jpeg(), has_icc_profile=True) is Curve.SRGB
    assert stated_curve(jpeg(), has_icc_profile=False) is Curve.UNTAGGED


@pytest.mark.parametrize("order", ["<", ">"])
def test_exif_orientation_in_both_byte_orders(order):
    assert exif_orientation(exif(6, order)) == 6


@pytest.mark.parametrize("block", [b"", b"Exif\x00\x00", exif(6)[:12], exif(99)])
def test_missing_or_damaged_exif_leaves_the_picture_as_it_stands(block):
    assert exif_orientation(block) == 1


# Where the stored top left corner (value 0) and top right corner (value 1) of a 2 x 2 picture are shown, by EXIF 2.3.
@pytest.mark.parametrize(
    ("orientation", "shown"),
    [
        (1, [[0, 1], [2, 3]]),
        (2, [[1, 0], [3, 2]]),
        (3, [[3, 2], [1, 0]]),
        (4, [[2, 3], [0, 1]]),
        (5, [[0, 2], [1, 3]]),
        (6, [[2, 0], [3, 1]]),
        (7, [[3, 1], [2, 0]]),
        (8, [[1, 3], [0, 2]]),
    ],
)
def test_orientations(orientation, shown):
    stored = np.array([[0, 1], [2, 3]])
    assert apply_orientation(stored, orientation).tolist() == shown
