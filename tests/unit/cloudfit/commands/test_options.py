import math
from pathlib import Path

import pytest
import torch

from cloudfit.commands.options import (
    AmbientName,
    CameraType,
    QualityName,
    SceneChoice,
    SearchChoice,
    TransferName,
)
from cloudfit.fit_types import FitOptions
from cloudfit.optimisers import OPTIMISERS
from cloudfit.quality import QUALITIES
from render.camera import OrthographicCamera, PinholeCamera
from render.colour import DISPLAY_CURVES
from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.volume_files import write_volume


@pytest.fixture
def volume(tmp_path: Path) -> Path:
    path = tmp_path / "cloud.npz"
    write_volume(path, DensityGrid.from_voxel_size(torch.ones(3, 3, 3), 10.0))
    return path


def test_the_names_are_those_of_the_registries() -> None:
    assert {name.value for name in QualityName} == set(QUALITIES)
    assert {name.value for name in TransferName} == set(DISPLAY_CURVES)
    assert {name.value for name in AmbientName} == {"sun", "sky", "free"}


def test_degrees_become_radians(volume: Path) -> None:
    choice = SceneChoice(
        volume,
        sun_azimuth=90.0,
        sun_elevation=30.0,
        camera_fov=60.0,
        camera_distance=100.0,
        camera_width=8,
        camera_height=6,
    )
    scene = choice.load()
    assert scene.sun_direction.tolist() == pytest.approx([math.cos(math.pi / 6), 0.0, 0.5], abs=1e-6)
    assert isinstance(scene.camera, PinholeCamera)
    assert scene.camera.field_of_view == pytest.approx(math.pi / 3)
    assert math.dist(scene.camera.position, scene.camera.target) == pytest.approx(100.0)
    assert (scene.camera.width, scene.camera.height) == (8, 6)
    assert scene.volume == volume
    assert str(volume) in choice.describe()


def test_the_projection_is_a_choice(volume: Path) -> None:
    assert isinstance(SceneChoice(volume, camera_type=CameraType.ORTHOGRAPHIC).load().camera, OrthographicCamera)
    assert "procedural cumulus" in SceneChoice().describe()


def test_search_choices_become_options() -> None:
    assert SearchChoice().options() == FitOptions()
    choice = SearchChoice(QualityName.DRAFT, AmbientName.FREE, TransferName.NONE, "crs2_lm", 50, 2.5, 3, 7, 2, 0)
    assert choice.options() == FitOptions(
        QUALITIES["draft"], "free", "none", "crs2_lm", 50, 2.5, searches=2, candidates=3, seed=7, air_refinements=0
    )


def test_an_unknown_optimiser_is_answered_with_the_known_ones() -> None:
    with pytest.raises(ParameterError, match="no optimiser is called 'magic'") as caught:
        SearchChoice(optimiser="magic").options()
    with pytest.raises(ParameterError, match="no loss is called 'magic'; there are l1"):
        SearchChoice(loss="magic").options()
    assert SearchChoice(loss="soft_l1", coarse_air=True).options() == FitOptions(loss="soft_l1", coarse_air=True)
    assert all(name in str(caught.value) for name in OPTIMISERS)
    assert SearchChoice(optical_depths=(0.01, 2.0)).options() == FitOptions(optical_depths=(0.01, 2.0))
