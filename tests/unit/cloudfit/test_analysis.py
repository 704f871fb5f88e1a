from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from cloudfit.analysis import NoCloudError, analyse_photograph
from cloudfit.cloud_mask import Label
from cloudfit.photograph import Photograph, read_photograph
from render.errors import PhotographError
from render.image_files import write_exr, write_png
from tests.support.shared_data import shared_file
from tests.support.sky_scenes import clear_scene, cloudy_scene


def photograph(pixels: torch.Tensor, opaque: torch.Tensor | None = None) -> Photograph:
    size = tuple(pixels.shape[:2])
    opaque = torch.ones(size, dtype=torch.bool) if opaque is None else opaque
    return Photograph(Path("made_up.png"), pixels, size, 8, 1.0, "0" * 64, opaque)


def test_a_cloudy_scene_is_analysed():
    pixels, cloud, ground = cloudy_scene()
    analysis = analyse_photograph(photograph(pixels))
    assert analysis.mask.cloud[cloud].double().mean() > 0.95
    assert analysis.warnings == ()
    # Behind the clouds there is blue, and nothing of the green ground.
    assert (analysis.sky[cloud][:, 2] > analysis.sky[cloud][:, 0]).all()
    assert (analysis.sky[ground][:, 2] > analysis.sky[ground][:, 1]).all()
    assert float(analysis.sunlight.colour.min()) > 0.9
    assert analysis.sunlight.ambient_sky_colour[2] == 1.0


@pytest.mark.parametrize("name", ["neg_desert_clear", "neg_dusk_rocket"])
def test_a_photograph_without_clouds_says_so(name):
    with pytest.raises(NoCloudError, match=rf"{name}\.jpg: expected clouds.*--mask"):
        analyse_photograph(read_photograph(shared_file(f"photos/{name}.jpg")))


def test_no_cloud_is_a_photograph_error():
    with pytest.raises(PhotographError, match=r"made_up\.png"):
        analyse_photograph(photograph(clear_scene()))


def test_clouds_that_the_user_marks_are_believed_however_small():
    pixels = clear_scene()
    labels = torch.zeros(pixels.shape[:2], dtype=torch.uint8)
    labels[20:24, 30:40] = Label.CLOUD
    analysis = analyse_photograph(photograph(pixels), labels)
    assert int(analysis.mask.cloud.sum()) == 40
    assert analysis.mask.source == "corrected"


def test_clouds_that_the_user_denies_are_gone():
    pixels, _, _ = cloudy_scene()
    with pytest.raises(NoCloudError):
        analyse_photograph(photograph(pixels), torch.full(pixels.shape[:2], Label.NOT_CLOUD, dtype=torch.uint8))


def test_an_overcast_sky_warns_that_its_sky_is_a_guess():
    analysis = analyse_photograph(photograph(torch.full((40, 60, 3), 0.5)))
    assert analysis.mask.cloud_fraction == 1.0
    assert len(analysis.warnings) == 1
    assert "no clear sky" in analysis.warnings[0]


def test_transparent_pixels_are_neither_cloud_nor_sky():
    pixels, _, _ = cloudy_scene()
    opaque = torch.ones(pixels.shape[:2], dtype=torch.bool)
    opaque[:, :60] = False
    assert analyse_photograph(photograph(pixels, opaque)).mask.other[:, :60].all()


@pytest.mark.parametrize(
    "pixels",
    [
        torch.ones(30, 40, 3),
        torch.full((30, 40, 3), 0.2),
        torch.ones(1, 1, 3),
        torch.ones(2, 1, 3),
        torch.full((30, 40, 3), 6e4),
    ],
)
def test_extremes_that_can_be_analysed_hold_no_nan(pixels):
    analysis = analyse_photograph(photograph(pixels))
    assert torch.isfinite(analysis.sky).all()
    assert torch.isfinite(analysis.sunlight.colour).all()
    assert analysis.sky.shape == pixels.shape


@pytest.mark.parametrize("pixels", [torch.zeros(30, 40, 3), torch.zeros(1, 1, 3), clear_scene(1, 1)])
def test_extremes_that_show_no_cloud(pixels):
    with pytest.raises(NoCloudError):
        analyse_photograph(photograph(pixels))


@pytest.mark.parametrize("kind", ["8 bit", "16 bit", "alpha", "exr", "grey"])
def test_every_kind_of_file_gives_the_same_clouds(tmp_path, kind):
    pixels, cloud, ground = cloudy_scene()
    path = tmp_path / ("a.exr" if kind == "exr" else "a.png")
    if kind == "exr":
        write_exr(path, {"rgb": pixels * 1234.0})
    elif kind == "16 bit":
        write_png(path, pixels, bits=16)
    elif kind == "8 bit":
        write_png(path, pixels)
    else:
        write_png(path, pixels)
        stored = cv2.imread(str(path))
        extra = np.full(stored.shape[:2], 255, np.uint8)
        cv2.imwrite(
            str(path), cv2.cvtColor(stored, cv2.COLOR_BGR2GRAY) if kind == "grey" else np.dstack([stored, extra])
        )
    analysis = analyse_photograph(read_photograph(path))
    assert analysis.mask.cloud[cloud].double().mean() > 0.95
    if kind == "grey":
        # Without colour every sky is grey, hence overcast; only the landscape can be told from it.
        assert analysis.mask.cloud[ground].double().mean() < 0.1
    else:
        assert analysis.mask.cloud[~cloud].double().mean() < 0.05
