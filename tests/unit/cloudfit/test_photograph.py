import hashlib

import cv2
import numpy as np
import pytest
import torch

from cloudfit.photograph import list_photographs, radiance_exposure, read_photograph
from render.colour import luminance
from render.errors import PhotographError
from render.image_files import write_exr


def test_an_ordinary_photograph_is_not_rescaled(tmp_path):
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.full((30, 50, 3), 255, np.uint8))
    photograph = read_photograph(path, max_side=25)
    assert photograph.pixels.shape == (15, 25, 3)
    assert (photograph.pixels == 1.0).all()
    assert photograph.original_size == (30, 50)
    assert (photograph.exposure, photograph.bit_depth) == (1.0, 8)
    assert photograph.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert photograph.opaque.all()


def test_radiance_is_exposed_for_the_sky_and_not_for_the_sun(tmp_path):
    radiance = torch.rand(40, 60, 3, generator=torch.Generator().manual_seed(0)) * 50.0
    radiance[5:8, 5:8] = 6e4
    write_exr(tmp_path / "a.exr", {"rgb": radiance})
    photograph = read_photograph(tmp_path / "a.exr")
    torch.testing.assert_close(photograph.pixels, radiance * photograph.exposure)
    ordinary = float((luminance(photograph.pixels) <= 1.0).double().mean())
    assert ordinary == pytest.approx(0.98, abs=0.002)
    # Exposed by its maximum instead, everything but the sun would be black.
    assert float(photograph.pixels.median()) > 100.0 * float((radiance / radiance.max()).median())


def test_exposure_does_not_depend_on_the_unit_of_the_radiance():
    radiance = torch.rand(500, 3, generator=torch.Generator().manual_seed(0))
    assert radiance_exposure(radiance * 1e5) * 1e5 == pytest.approx(radiance_exposure(radiance), rel=1e-5)


@pytest.mark.parametrize("radiance", [torch.zeros(9, 3), torch.zeros(1, 3)])
def test_black_radiance_has_exposure_one(radiance):
    assert radiance_exposure(radiance) == 1.0


def test_a_lone_light_before_black_is_exposed_by_itself():
    radiance = torch.zeros(1000, 3)
    radiance[7] = 4.0
    assert radiance_exposure(radiance) == pytest.approx(0.25)


def test_transparent_pixels_are_marked(tmp_path):
    rgba = np.full((8, 10, 4), 200, np.uint8)
    rgba[:, :4, 3] = 0
    cv2.imwrite(str(tmp_path / "a.png"), rgba)
    opaque = read_photograph(tmp_path / "a.png").opaque
    assert not opaque[:, :4].any()
    assert opaque[:, 4:].all()
    cv2.imwrite(str(tmp_path / "b.png"), np.zeros((8, 10, 4), np.uint8))
    with pytest.raises(PhotographError, match="transparent everywhere"):
        read_photograph(tmp_path / "b.png")


def test_folders_and_files_are_listed_sorted_and_once(tmp_path):
    for name in ("b.JPG", "a.png", "c.exr", "notes.txt", ".hidden.png"):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "deeper.png").mkdir()
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "d.png").write_bytes(b"x")
    assert [p.name for p in list_photographs(tmp_path)] == ["a.png", "b.JPG", "c.exr"]
    both = list_photographs([tmp_path / "notes.txt", tmp_path, tmp_path / "a.png", tmp_path / "inner"])
    assert [p.name for p in both] == ["a.png", "b.JPG", "c.exr", "d.png", "notes.txt"]


def test_nothing_to_list_is_an_error(tmp_path):
    with pytest.raises(PhotographError, match="no image file"):
        list_photographs(tmp_path)
    with pytest.raises(PhotographError, match="no such file"):
        list_photographs(tmp_path / "gone")
