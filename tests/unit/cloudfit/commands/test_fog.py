import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from cloudfit.cli import app
from cloudfit.commands import fog
from cloudfit.commands.fog import DepthKind, MediumName
from cloudfit.sky_models import AccurateSky
from precompute.atmosphere import sky_view
from render.image_files import read_exr_layers, read_image, write_png
from render.media import MEDIA
from tests.support.skies import coarse_source

SMALL = ["--camera-width", "32", "--camera-height", "18", "--quiet"]
RUNNER = CliRunner(env={"COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"})


def run(*arguments: str | Path, code: int = 0) -> str:
    outcome = RUNNER.invoke(app, ["fog", *map(str, arguments)])
    assert outcome.exit_code == code, outcome.output
    return outcome.stdout if code == 0 else outcome.stderr


def test_the_names_are_those_of_the_registry() -> None:
    assert {name.value for name in MediumName} == set(MEDIA)
    assert {kind.value for kind in DepthKind} == {"distance", "z"}


@pytest.mark.parametrize("medium", MEDIA)
def test_the_plain_is_written_as_png_and_exr(tmp_path: Path, medium: str) -> None:
    png, exr = tmp_path / "fog.png", tmp_path / "fog.exr"
    assert run("--medium", medium, "--out", png, "--out", exr, *SMALL).split() == [str(png), str(exr)]
    layers = read_exr_layers(exr)
    assert layers["rgb"].shape == (18, 32, 3)
    assert read_image(png).pixels.shape == (18, 32, 3)
    torch.testing.assert_close(read_image(png).pixels, layers["rgb"].clamp(0.0, 1.0), atol=0.01, rtol=0.02)
    assert ((layers["transmittance"] >= 0.0) & (layers["transmittance"] <= 1.0)).all()
    assert (layers["scattered"] <= layers["rgb"] + 1e-6).all()
    assert torch.isinf(layers["distance"]).any()
    assert torch.isfinite(layers["distance"]).any()


def test_less_visibility_is_more_fog(tmp_path: Path) -> None:
    left = []
    for visibility in ("inf", "2000", "200"):
        out = tmp_path / f"{visibility}.exr"
        run("--visibility", visibility, "--out", out, *SMALL)
        left.append(read_exr_layers(out)["transmittance"].mean().item())
    assert left[0] == 1.0
    assert left[0] > left[1] > left[2]


def test_an_atmosphere_lights_the_plain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fog, "prepare_air", lambda folder, report: AccurateSky(coarse_source()))
    monkeypatch.setattr(sky_view, "LOW", (32, 24))
    seen = {}
    for name, arguments in (
        ("gradient", []),
        ("air", ["--atmosphere"]),
        ("dusk", ["--atmosphere", "--sun-elevation", "2"]),
    ):
        run(*arguments, "--visibility", "1000", "--out", tmp_path / f"{name}.exr", *SMALL)
        seen[name] = read_exr_layers(tmp_path / f"{name}.exr")
    assert torch.equal(seen["air"]["transmittance"], seen["gradient"]["transmittance"])
    assert not torch.allclose(seen["air"]["rgb"], seen["gradient"]["rgb"], rtol=0.05)
    means = {name: layers["rgb"].mean((0, 1)) for name, layers in seen.items()}
    assert 0.3 < float(means["air"].mean() / means["gradient"].mean()) < 3.0, "the same unit"
    assert bool((means["dusk"] < means["air"]).all())
    assert "leave" in run("--atmosphere", "--sun-colour", "1,1,1", "--out", tmp_path / "x.png", code=3)


def test_a_sheet_shows_three_densities(tmp_path: Path) -> None:
    document = json.loads(run("--sheet", "--json", "--visibility", "400", "--out", tmp_path / "sheet.png", *SMALL))
    assert read_image(tmp_path / "sheet.png").pixels.shape == (18, 96, 3)
    assert [fog["visibility_m"] for fog in document["fogs"]] == [1600.0, 400.0, 100.0]
    depths = [fog["vertical_optical_depth"] for fog in document["fogs"]]
    assert depths[1] == pytest.approx(-0.5 * math.log(0.05) / 400.0 * 60.0)
    assert depths[2] == pytest.approx(16.0 * depths[0])
    assert document["schema"] == "cloudfit fog 1"


def test_exposure_brightens_by_stops(tmp_path: Path) -> None:
    for stops in ("0", "1.5"):
        run("--exposure", stops, "--out", tmp_path / f"{stops}.exr", *SMALL)
    plain, bright = (read_exr_layers(tmp_path / f"{stops}.exr") for stops in ("0", "1.5"))
    torch.testing.assert_close(bright["rgb"], 2.0**1.5 * plain["rgb"])
    assert torch.equal(bright["transmittance"], plain["transmittance"])


def test_a_picture_with_its_depth_is_fogged(tmp_path: Path) -> None:
    photo, depth = tmp_path / "street.png", tmp_path / "street.npy"
    write_png(photo, torch.full((12, 16, 3), 0.2))
    metres = np.full((12, 16), 50.0)
    metres[:3] = np.inf
    np.save(depth, metres)
    common = [
        "--image",
        photo,
        "--depth",
        depth,
        "--medium",
        "uniform",
        "--fog-height",
        "500",
        "--visibility",
        "100",
        "--quiet",
    ]
    run(*common, "--out", tmp_path / "ray.exr")
    run(*common, "--depth-kind", "z", "--out", tmp_path / "axis.exr")
    ray, axis = (read_exr_layers(tmp_path / f"{name}.exr")["transmittance"] for name in ("ray", "axis"))
    assert ray[6, 8].item() == pytest.approx(0.05**0.5, rel=1e-5)
    assert axis[6, 8].item() == pytest.approx(0.05**0.5, rel=2e-3)
    assert axis[-1, 0] < 0.97 * ray[-1, 0]


def test_a_sky_of_one_s_own_stands_behind_the_plain(tmp_path: Path) -> None:
    write_png(tmp_path / "sky.png", torch.tensor([0.9, 0.1, 0.1]).expand(9, 16, 3))
    run("--sky", tmp_path / "sky.png", "--visibility", "inf", "--out", tmp_path / "red.png", *SMALL)
    top = read_image(tmp_path / "red.png").pixels[0]
    assert (top[:, 0] > 5.0 * top[:, 1]).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--out", "fog.jpg"], "fog.jpg: expected a name that ends in"),
        (["--image", "x.png"], "go together"),
        (["--depth", "x.exr"], "go together"),
        (["--image", "x.png", "--depth", "x.exr", "--sky", "y.png"], "--sky"),
        (["--image", "gone.png", "--depth", "gone.exr"], "gone.png: no such file"),
        (["--sky", "gone.png"], "gone.png: no such file"),
        (["--visibility", "0"], "positive visibility"),
        (["--visibility", "nan"], "positive visibility"),
        (["--fog-height", "-3"], "base below the top"),
        (["--sun-colour", "red"], "red,green,blue"),
    ],
)
def test_bad_input_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    message = run(*SMALL, *arguments, code=3)
    assert words in message
    assert len(message.strip().splitlines()) <= 2
    assert not list(tmp_path.iterdir())
