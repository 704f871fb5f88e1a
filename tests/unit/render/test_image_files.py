from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
import torch

from render.colour import srgb_to_linear
from render.errors import PhotographError
from render.image_files import read_exr_layers, read_image, read_mask_png, write_exr, write_mask_png, write_png
from tests.unit.render.test_image_containers import exif


def picture(height: int = 12, width: int = 20) -> np.ndarray:
    """BGR as OpenCV stores it, with a red top left quarter."""
    values = np.full((height, width, 3), 60, np.uint8)
    values[: height // 2, : width // 2] = (10, 20, 230)
    return values


def save(path: Path, values: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), values)
    return path


def with_orientation(path: Path, orientation: int) -> Path:
    """JPEG of `picture` with an EXIF block right behind its first marker."""
    data = cv2.imencode(".jpg", picture(), [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    block = exif(orientation)
    path.write_bytes(data[:2] + b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block + data[2:])
    return path


def test_eight_bits_are_decoded_by_the_srgb_curve(tmp_path):
    image = read_image(save(tmp_path / "a.png", picture()))
    expected = srgb_to_linear(torch.tensor([230.0, 20.0, 10.0]) / 255.0)
    torch.testing.assert_close(image.pixels[0, 0], expected)
    assert (image.bit_depth, image.linear_source, image.original_size) == (8, False, (12, 20))
    assert image.alpha is None


def test_orientation_of_a_jpeg_is_honoured(tmp_path):
    upright = read_image(with_orientation(tmp_path / "a.jpg", 1)).pixels
    turned = read_image(with_orientation(tmp_path / "b.jpg", 6))
    assert turned.original_size == (20, 12)
    torch.testing.assert_close(turned.pixels, upright.rot90(-1, (0, 1)))
    assert not torch.allclose(turned.pixels, upright.rot90(1, (0, 1)))


def test_untagged_sixteen_bits_are_linear_and_tagged_ones_as_tagged(tmp_path):
    linear = torch.rand(6, 7, 3, generator=torch.Generator().manual_seed(0))
    stored = (linear.numpy()[..., ::-1] * 65535.0).round().astype(np.uint16)
    for suffix in (".png", ".tiff"):
        image = read_image(save(tmp_path / f"a{suffix}", stored))
        assert image.bit_depth == 16
        torch.testing.assert_close(image.pixels, linear, atol=2e-5, rtol=0.0)
    write_png(tmp_path / "tagged.png", linear, "srgb", bits=16)
    torch.testing.assert_close(read_image(tmp_path / "tagged.png").pixels, linear, atol=4e-5, rtol=0.0)


@pytest.mark.parametrize("curve", ["srgb", "none"])
def test_a_written_png_is_read_back(tmp_path, curve):
    linear = torch.rand(5, 9, 3, generator=torch.Generator().manual_seed(0))
    write_png(tmp_path / "a.png", linear, curve)
    torch.testing.assert_close(read_image(tmp_path / "a.png").pixels, linear, atol=5e-3, rtol=0.0)
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


def test_a_png_of_nan_or_of_another_shape_is_refused(tmp_path):
    with pytest.raises(ValueError, match="NaN"):
        write_png(tmp_path / "a.png", torch.full((2, 2, 3), torch.nan))
    with pytest.raises(ValueError, match="height"):
        write_png(tmp_path / "a.png", torch.zeros(2, 2))


def test_grey_palette_and_alpha(tmp_path):
    grey = read_image(save(tmp_path / "grey.png", picture()[..., 0]))
    assert grey.pixels.shape == (12, 20, 3)
    assert (grey.pixels.std(dim=2) == 0.0).all()
    alpha = np.zeros((12, 20), np.uint8)
    alpha[:, 10:] = 255
    clear = read_image(save(tmp_path / "alpha.png", np.dstack([picture(), alpha])))
    assert clear.alpha is not None
    assert clear.alpha[:, :10].max() == 0.0
    assert clear.alpha[:, 10:].min() == 1.0
    # Dropped, not composited: the colour under transparent pixels is the stored one.
    torch.testing.assert_close(clear.pixels, read_image(save(tmp_path / "plain.png", picture())).pixels)


def test_reduction_averages_areas_and_keeps_the_shape(tmp_path):
    board = np.kron(np.indices((40, 60)).sum(0) % 2, np.ones((2, 2))).astype(np.uint8)[..., None] * np.full(
        3, 200, np.uint8
    )
    image = read_image(save(tmp_path / "a.png", board), max_side=30)
    assert image.pixels.shape == (20, 30, 3)
    assert image.original_size == (80, 120)
    torch.testing.assert_close(image.pixels, srgb_to_linear(torch.full((20, 30, 3), 100.0 / 255.0)))
    assert read_image(tmp_path / "a.png", max_side=500).pixels.shape == (80, 120, 3)


def test_radiance_files_are_linear(tmp_path):
    radiance = torch.rand(8, 9, 3, generator=torch.Generator().manual_seed(0)) * 40.0
    write_exr(tmp_path / "a.exr", {"rgb": radiance})
    save(tmp_path / "a.hdr", np.ascontiguousarray(radiance.numpy()[..., ::-1]))
    exr, hdr = read_image(tmp_path / "a.exr"), read_image(tmp_path / "a.hdr")
    assert exr.linear_source
    assert hdr.linear_source
    assert exr.bit_depth == 32
    torch.testing.assert_close(exr.pixels, radiance)
    # RGBE shares one exponent: eight bits of the largest channel.
    torch.testing.assert_close(hdr.pixels, radiance, atol=40.0 / 128.0, rtol=0.0)


def test_exr_layers_are_read_back_by_name(tmp_path):
    layers = {"rgb": torch.rand(4, 5, 3), "single": torch.rand(4, 5, 3), "transmittance": torch.rand(4, 5)}
    write_exr(tmp_path / "a.exr", layers)
    read = read_exr_layers(tmp_path / "a.exr")
    assert read.keys() == layers.keys()
    for name, layer in layers.items():
        torch.testing.assert_close(read[name], layer)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        names = set(file.parts[0].channels)
    assert names == {"R", "G", "B", "single.R", "single.G", "single.B", "transmittance.Y"}


def test_layers_of_different_sizes_are_refused(tmp_path):
    with pytest.raises(ValueError, match="one size"):
        write_exr(tmp_path / "a.exr", {"rgb": torch.zeros(4, 5, 3), "single": torch.zeros(4, 6, 3)})


def test_masks_are_read_back(tmp_path):
    mask = torch.rand(6, 7, generator=torch.Generator().manual_seed(0)) > 0.5
    write_mask_png(tmp_path / "a.png", mask)
    assert np.array_equal(read_mask_png(tmp_path / "a.png"), mask.numpy() * np.uint8(255))
    labels = np.array([[0, 85], [170, 255]], np.uint8)
    write_mask_png(tmp_path / "b.png", labels)
    assert np.array_equal(read_mask_png(tmp_path / "b.png"), labels)
    with pytest.raises(PhotographError, match="coloured"):
        read_mask_png(save(tmp_path / "c.png", picture()))


def cut(data: bytes, share: float) -> bytes:
    return data[: int(share * len(data))]


def test_files_that_are_no_pictures_name_themselves_and_the_reason(tmp_path):
    (tmp_path / "empty.jpg").write_bytes(b"")
    (tmp_path / "text.jpg").write_bytes(b"this is a letter, not a picture")
    for name, reason in (
        ("empty.jpg", "zero bytes"),
        ("text.jpg", "not an image"),
        ("missing.jpg", "no such file"),
        ("", "directory"),
    ):
        with pytest.raises(PhotographError, match=reason) as error:
            read_image(tmp_path / name)
        assert str(tmp_path / name) in str(error.value)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tiff", ".webp", ".bmp", ".hdr", ".exr"])
@pytest.mark.parametrize("share", [0.3, 0.97])
def test_truncated_files_are_refused(tmp_path, suffix, share):
    generator = np.random.default_rng(0)
    path = tmp_path / f"whole{suffix}"
    noise = generator.integers(0, 255, (60, 80, 3)).astype(np.uint8)
    if suffix == ".exr":
        write_exr(path, {"rgb": torch.from_numpy(noise / 255.0)})
    else:
        save(path, noise.astype(np.float32) / 255.0 if suffix == ".hdr" else noise)
    read_image(path)
    broken = tmp_path / f"broken{suffix}"
    broken.write_bytes(cut(path.read_bytes(), share))
    with pytest.raises(PhotographError, match="truncated") as error:
        read_image(broken)
    assert "broken" in str(error.value)


@pytest.mark.parametrize(
    ("value", "reason"), [(float("nan"), "NaN"), (float("inf"), "infinite"), (-1.0, "negative"), (-np.inf, "infinite")]
)
def test_values_that_are_no_light_are_refused(tmp_path, value, reason):
    radiance = torch.ones(4, 4, 3)
    radiance[1, 2, 0] = value
    write_exr(tmp_path / "a.exr", {"rgb": radiance})
    with pytest.raises(PhotographError, match=f"1 {reason}"):
        read_image(tmp_path / "a.exr")
    with pytest.raises(PhotographError, match=f"1 {reason}"):
        read_image(save(tmp_path / "a.tiff", radiance.numpy()))


def test_an_exr_without_colour_is_refused(tmp_path):
    write_exr(tmp_path / "a.exr", {"depth": torch.ones(3, 3)})
    with pytest.raises(PhotographError, match=r"R, G, B or Y, got depth\.Y"):
        read_image(tmp_path / "a.exr")


def test_a_hundred_megapixels_are_reduced(tmp_path):
    data = cv2.imencode(".png", np.full((10_000, 10_000), 128, np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
    (tmp_path / "a.png").write_bytes(data.tobytes())
    image = read_image(tmp_path / "a.png", max_side=100)
    assert image.original_size == (10_000, 10_000)
    torch.testing.assert_close(image.pixels, srgb_to_linear(torch.full((100, 100, 3), 128.0 / 255.0)))
