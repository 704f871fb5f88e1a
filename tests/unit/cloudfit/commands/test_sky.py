"""`cloudfit sky`: pictures, panorama and sheet from small tables; wrong usage and bad input by their exit codes."""

import json
from pathlib import Path

import pytest
import torch
from click.testing import Result
from typer.testing import CliRunner

from cloudfit import sky_models
from cloudfit.cli import app
from cloudfit.commands.options import QualityName
from cloudfit.commands.sky import SkyMode
from precompute.atmosphere import sky_view
from precompute.atmosphere_tables import TablePlan
from render.atmosphere.tables import TableSizes
from render.image_files import read_exr_layers, read_image

TINY = TablePlan(sizes=TableSizes(8, 32, 4, 8, 4, 16, 3, 8), orders=2)
SIZE = ["--width", "24", "--height", "16"]


@pytest.fixture(autouse=True)
def small_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sky_models.PLANS, "standard", TINY)
    monkeypatch.setitem(sky_models.TOLERANCES, "standard", 0.5)
    monkeypatch.setattr(sky_view, "LOW", (32, 24))


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that tests share, so that a source function is built once."""
    return tmp_path_factory.mktemp("tables")


def run(*arguments: str | Path, mode: str = "parity") -> Result:
    return CliRunner().invoke(app, ["sky", "--mode", mode, *map(str, arguments)])


def test_both_modes_see_nearly_the_same_sky(tmp_path: Path, tables: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sky_models, "WAVELENGTHS", (650e-9, 550e-9, 450e-9))
    seen = {}
    for mode in SkyMode:
        out = tmp_path / f"{mode}.exr"
        done = run("--out", out, *SIZE, "--json", "--tables", tables, mode=mode)
        assert done.exit_code == 0, done.output
        assert json.loads(done.stdout)["mode"] == mode
        seen[mode] = read_exr_layers(out)["rgb"]
    ratio = seen[SkyMode.PARITY] / seen[SkyMode.ACCURATE]
    assert 0.8 < float(ratio.median()) < 1.2
    assert float((ratio - 1.0).abs().max()) > 1e-3, "two models, not one"


def test_the_accurate_sky_is_the_default(tmp_path: Path, tables: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sky_models, "WAVELENGTHS", (650e-9, 550e-9, 450e-9))
    arguments = ["sky", "--out", str(tmp_path / "x.png"), *SIZE, "--json", "--tables", str(tables)]
    done = CliRunner().invoke(app, arguments)
    assert json.loads(done.stdout)["mode"] == "accurate"


def test_a_picture_and_its_tables(tmp_path: Path) -> None:
    out = tmp_path / "noon.png"
    first = run("--out", out, *SIZE, "--json", "--quiet")
    assert first.exit_code == 0, first.output
    document = json.loads(first.stdout)
    assert document["reused"] is False
    assert document["white_cd_m2"][0] > 100.0
    pixels = read_image(out).pixels
    assert pixels.shape == (16, 24, 3)
    assert float(pixels[2, 2, 2]) > float(pixels[2, 2, 0])
    exr = tmp_path / "noon.exr"
    second = run("--out", exr, *SIZE, "--json")
    assert json.loads(second.stdout)["reused"] is True
    radiance = read_exr_layers(exr)["rgb"]
    assert float(radiance.max()) > 1000.0
    darker = run("--out", out, *SIZE, "--exposure", "-3")
    assert darker.stdout.strip() == str(out)
    assert float(read_image(out).pixels.mean()) < 0.5 * float(pixels.mean())


def test_altitude_sun_and_haze_change_the_picture(tmp_path: Path) -> None:
    pictures = []
    for number, change in enumerate(
        ([], ["--altitude", "9000"], ["--sun-elevation", "5"], ["--aerosol", "10"], ["--ground-albedo", "0.8"])
    ):
        out = tmp_path / f"{number}.exr"
        assert run("--out", out, *SIZE, *change, "--quiet").exit_code == 0
        pictures.append(read_exr_layers(out)["rgb"])
    for other in pictures[1:]:
        assert not torch.allclose(pictures[0], other, rtol=1e-2)


def test_panorama_and_sheet_have_their_shapes(tmp_path: Path) -> None:
    out = tmp_path / "wide.png"
    assert run("--out", out, "--panorama", "--width", "30").exit_code == 0
    assert read_image(out).pixels.shape == (15, 30, 3)
    done = run("--out", out, *SIZE, "--sweep-sun", "5", "--json")
    document = json.loads(done.stdout)
    assert document["sun_elevation_deg"] == [60.0, 42.0, 24.0, 6.0, -12.0]
    assert document["white_cd_m2"][2] > document["white_cd_m2"][3] > 10.0 * document["white_cd_m2"][4]
    assert read_image(out).pixels.shape == (32, 72, 3)
    assert float(read_image(out).pixels[16:, 48:].max()) == 0.0
    sheet = tmp_path / "day.exr"
    assert run("--out", sheet, *SIZE, "--sweep-sun", "2").exit_code == 0
    assert read_exr_layers(sheet)["rgb"].shape == (16, 48, 3)


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--out", "sky.jpg"], 3),
        (["--aerosol", "-1"], 2),
        (["--altitude", "-5"], 2),
        (["--sun-elevation", "91"], 2),
        (["--ground-albedo", "1.5"], 2),
        (["--sweep-sun", "1"], 2),
        (["--altitude", "nan"], 2),
        (["--exposure", "inf"], 3),
    ],
)
def test_wrong_usage_and_bad_input(
    arguments: list[str], code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*SIZE, *arguments).exit_code == code
    assert not list(tmp_path.glob("sky.*"))


def test_each_quality_and_mode_is_known() -> None:
    assert list(sky_models.PLANS) == list(sky_models.TOLERANCES) == [quality.value for quality in QualityName]
    assert list(sky_models.SKY_MODES) == [mode.value for mode in SkyMode]
