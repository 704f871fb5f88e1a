import json
from pathlib import Path
from typing import Any

import pytest
import torch
import typer

from cloudfit import atmosphere_picture, sky_models
from cloudfit import picture as picture_module
from cloudfit.commands.render import SkyName, render, write_picture
from cloudfit.fit_types import Picture
from cloudfit.photograph import read_photograph
from cloudfit.result import read_result, write_result
from cloudfit.result_document import Circumstances, describe_fit, describe_reason
from cloudfit.result_folder import write_fit, write_reason
from cloudfit.scene import Scene
from render.atmosphere.earth import earth
from render.camera import PinholeCamera
from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.image_files import read_exr_layers, read_image
from render.volume_files import write_volume
from tests.support.hand_made_fit import (
    SECONDS,
    make_analysis,
    make_fit,
    make_picture,
    make_question,
    make_space,
    small_scene,
    write_photograph,
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    photograph = write_photograph(tmp_path / "photo.png")
    plain = small_scene()
    volume = tmp_path / "cloud.npz"
    write_volume(volume, plain.grid)
    scene = Scene(plain.grid, volume, plain.camera, plain.sun_azimuth, plain.sun_elevation)
    fit = make_fit(make_analysis(read_photograph(photograph)))
    circumstances = Circumstances(photograph, None, make_question(scene=scene), SECONDS)
    write_fit(tmp_path / "photo", fit, describe_fit(fit, make_space(), circumstances), "token")
    return tmp_path / "photo"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """What the renderer is asked for, while a stand-in answers."""
    calls: list[tuple[Any, ...]] = []

    def stand_in(scene: Scene, *arguments: Any) -> Picture:
        calls.append((scene, *arguments))
        return make_picture(0.5, scene.camera.width, scene.camera.height)

    monkeypatch.setattr(picture_module, "render_picture", stand_in)
    return calls


def test_a_result_is_rendered_as_it_was_fitted(folder: Path, asked: list[tuple[Any, ...]]) -> None:
    render(folder, folder.parent / "again.png", candidate=2)
    scene, parameters, air_depth, sunlight, ambient, sky, _, seed, _ = asked[0]
    plain = small_scene()
    assert torch.allclose(scene.camera.rays()[1], plain.camera.rays()[1], atol=1e-6)
    assert torch.allclose(scene.sun_direction, plain.sun_direction, atol=1e-6)
    assert parameters["asymmetry"] == pytest.approx(0.4)
    assert air_depth == (0.0, 0.3, 0.6)
    assert sunlight.tolist() == pytest.approx([1.0, 0.9, 0.8])
    assert ambient.tolist() == pytest.approx([1.0, 0.9, 0.8])
    assert torch.equal(sky, read_exr_layers(folder / "sky.exr")["rgb"])
    assert seed == 0
    assert read_image(folder.parent / "again.png").pixels.shape == (6, 8, 3)


def test_size_camera_and_sun_can_be_others(folder: Path, asked: list[tuple[Any, ...]]) -> None:
    render(folder / "result.json", folder.parent / "side.exr", width=16, camera_azimuth=90.0, sun_elevation=5.0, seed=9)
    scene, *_, seed, _ = asked[0]
    assert isinstance(scene.camera, PinholeCamera)
    assert (scene.camera.width, scene.camera.height) == (16, 12), "the rows follow"
    assert scene.camera.position[0] < scene.camera.target[0], "looking east from the west"
    assert scene.sun_direction[2] == pytest.approx(0.0871557, abs=1e-6)
    assert seed == 9
    layers = read_exr_layers(folder.parent / "side.exr")
    assert layers["transmittance"].shape == (12, 16)


@pytest.fixture
def asked_in_air(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """What the renderer of a cloud in an atmosphere is asked for, while a stand-in answers; no tables are filled."""
    calls: list[tuple[Any, ...]] = []

    def stand_in(scene: Scene, *arguments: Any) -> Picture:
        calls.append((scene, *arguments))
        return make_picture(3000.0, scene.camera.width, scene.camera.height)

    monkeypatch.setattr(atmosphere_picture, "render_in_atmosphere", stand_in)
    monkeypatch.setattr(sky_models, "prepare_sky", lambda *arguments: (arguments, None))
    return calls


def test_the_sky_can_be_an_atmosphere(folder: Path, asked_in_air: list[tuple[Any, ...]]) -> None:
    out = folder.parent / "air.exr"
    render(folder, out, sky=SkyName.ATMOSPHERE, cloud_distance=8000.0, altitude=50.0, aerosol=3.0, sun_elevation=5.0)
    scene, parameters, model, place, _, seed, _ = asked_in_air[0]
    mode, atmosphere, quality, tables, _ = model
    assert (mode, quality, seed) == ("accurate", read_result(folder)["options"]["quality"], 0)
    assert atmosphere.mie_scattering[0] == pytest.approx(3.0 * earth().mie_scattering[0])
    assert tables == folder.parent / ".tables"
    assert (place.altitude, place.distance) == (50.0, 8000.0)
    assert scene.sun_direction[2] == pytest.approx(0.0871557, abs=1e-6)
    assert parameters == {
        name: entry["value"] for name, entry in read_result(folder)["candidates"][0]["parameters"].items()
    }
    assert float(read_exr_layers(out)["single"].max()) > 1000.0, "in cd/m^2"


def test_the_albedo_can_be_that_of_water(folder: Path, asked_in_air: list[tuple[Any, ...]]) -> None:
    render(folder, folder.parent / "air.png", sky=SkyName.ATMOSPHERE, cloud_albedo=0.75)
    fitted = read_result(folder)["candidates"][0]["parameters"]["albedo"]["value"]
    assert asked_in_air[0][1]["albedo"] == 0.75 != fitted


def test_an_atmosphere_is_exposed(folder: Path, asked_in_air: list[tuple[Any, ...]]) -> None:
    means = []
    for exposure in (0.0, -3.0):
        out = folder.parent / "air.png"
        render(folder, out, sky=SkyName.ATMOSPHERE, exposure=exposure)
        means.append(float(read_image(out).pixels.mean()))
    assert 0.2 < means[0] < 0.8
    assert means[1] < 0.5 * means[0]


def test_a_cloud_below_the_ground_is_refused(
    folder: Path, asked_in_air: list[tuple[Any, ...]], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(typer.Exit) as caught:
        render(folder, folder.parent / "x.png", sky=SkyName.ATMOSPHERE, cloud_distance=5000.0, camera_elevation=-30.0)
    assert caught.value.exit_code == 3
    assert "below the ground" in capsys.readouterr().err
    assert not asked_in_air


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("candidate", 3, "a candidate out of 1 to 2"),
        ("out", Path("x.jpg"), "ends in .png or .exr"),
        ("volume", Path("gone.npz"), "gone.npz"),
    ],
)
def test_bad_requests_are_answered_with_a_sentence(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, value: Any, words: str
) -> None:
    with pytest.raises(typer.Exit) as caught:
        render(**{"result": folder, "out": folder.parent / "again.png", name: value})
    assert caught.value.exit_code == 3
    assert words in capsys.readouterr().err


def test_another_volume_is_refused_unless_asked_for(
    folder: Path, asked: list[tuple[Any, ...]], capsys: pytest.CaptureFixture[str]
) -> None:
    other = folder.parent / "cloud.npz"
    write_volume(other, DensityGrid.from_voxel_size(torch.full((4, 4, 4), 0.25), 10.0))
    with pytest.raises(typer.Exit):
        render(folder, folder.parent / "again.png")
    assert "not the volume that was fitted" in capsys.readouterr().err
    render(folder, folder.parent / "again.png", volume=other)
    assert float(asked[0][0].grid.density.max()) == 0.25


def test_a_photograph_that_was_not_fitted_cannot_be_rendered(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    circumstances = Circumstances(Path("photo.png"), None, make_question(), SECONDS)
    write_reason(folder, None, describe_reason("no_cloud", "there is none", circumstances), "token")
    with pytest.raises(typer.Exit):
        render(folder, folder.parent / "again.png")
    assert "there is none" in capsys.readouterr().err


def test_a_quality_that_is_no_preset_must_be_replaced(
    folder: Path, asked: list[tuple[Any, ...]], capsys: pytest.CaptureFixture[str]
) -> None:
    document = read_result(folder)
    document["options"]["quality"] = "custom"
    write_result(folder / "result.json", document)
    with pytest.raises(typer.Exit):
        render(folder, folder.parent / "again.png")
    assert "--quality" in capsys.readouterr().err


def test_json_names_the_picture(folder: Path, asked: list[tuple[Any, ...]], capsys: pytest.CaptureFixture[str]) -> None:
    render(folder, folder.parent / "again.png", json=True)
    assert json.loads(capsys.readouterr().out)["file"].endswith("again.png")


def test_pictures_have_two_formats(tmp_path: Path) -> None:
    picture = make_picture(0.5)
    write_picture(tmp_path / "x.EXR", picture)
    assert torch.equal(read_exr_layers(tmp_path / "x.EXR")["single"], picture.single)
    with pytest.raises(ParameterError):
        write_picture(tmp_path / "x.tif", picture)
