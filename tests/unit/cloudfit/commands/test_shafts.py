import json
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from cloudfit.cli import app
from cloudfit.commands.shafts import MethodName
from render.image_files import read_exr_layers, read_image
from render.shafts.methods import METHODS
from render.shafts.scene_file import PRESETS

SMALL = ["--camera-width", "32", "--camera-height", "18", "--sun-map", "128", "--lamp-map", "32", "--quiet"]
RUNNER = CliRunner(env={"COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"})


def run(*arguments: str | Path, code: int = 0) -> str:
    outcome = RUNNER.invoke(app, ["shafts", *map(str, arguments)])
    assert outcome.exit_code == code, outcome.output
    return outcome.stdout if code == 0 else outcome.stderr


def test_the_names_are_those_of_the_registry() -> None:
    assert [name.value for name in MethodName] == list(METHODS)


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_are_written_as_png_and_exr(tmp_path: Path, preset: str) -> None:
    png, exr = tmp_path / "a.png", tmp_path / "a.exr"
    assert run(preset, "--out", png, "--out", exr, *SMALL).split() == [str(png), str(exr)]
    layers = read_exr_layers(exr)
    whole = layers["transmittance"] * layers["background"] + layers["in_scattering"] + layers["ambient"]
    torch.testing.assert_close(layers["rgb"], whole, rtol=1e-4, atol=1e-5)
    assert read_image(png).pixels.shape == (18, 32, 3)
    assert float(layers["in_scattering"].max()) > 0.01


@pytest.mark.parametrize("method", METHODS)
def test_methods_show_the_same_scene(tmp_path: Path, method: str) -> None:
    size = ["--camera-width", "128", "--camera-height", "72", "--sun-map", "256", "--quiet"]
    for name in ("brute_force", method):
        run("window", "--method", name, "--out", tmp_path / f"{name}.exr", *size)
    exact, other = (read_exr_layers(tmp_path / f"{name}.exr")["in_scattering"] for name in ("brute_force", method))
    assert float((other - exact).square().mean().sqrt()) < 0.1 * float(exact.square().mean().sqrt())


def test_times_of_day_stand_side_by_side(tmp_path: Path) -> None:
    document = json.loads(run("columns", "--sheet-times", "6,12", "--json", "--out", tmp_path / "day.png", *SMALL))
    assert read_image(tmp_path / "day.png").pixels.shape == (18, 64, 3)
    assert document["schema"] == "cloudfit shafts 1"
    assert len(document["frames"]) == 2
    assert document["frames"][0]["modelled"]
    pixels = read_image(tmp_path / "day.png").pixels
    assert not torch.equal(pixels[:, :32], pixels[:, 32:])


def test_fog_drifts_from_file_to_file(tmp_path: Path) -> None:
    seconds = ["--sheet-seconds", "0,15", *SMALL]
    files = run("lamps_in_fog", "--out", tmp_path / "fog_{}.exr", "--out", tmp_path / "both.png", *seconds).split()
    assert files == [str(tmp_path / name) for name in ("fog_000.exr", "fog_001.exr", "both.png")]
    first, later = (read_exr_layers(Path(name))["transmittance"] for name in files[:2])
    assert float((first - later).abs().max()) > 0.05
    assert read_image(tmp_path / "both.png").pixels.shape == (18, 64, 3)
    run("lamps_in_fog", "--fog-strength", "0", "--out", tmp_path / "clear.exr", *SMALL)
    assert float(read_exr_layers(tmp_path / "clear.exr")["transmittance"].mean()) > float(first.mean())


def test_fog_that_is_not_there_cannot_drift(tmp_path: Path) -> None:
    assert "no bank of fog" in run("window", "--sheet-seconds", "0,1", "--out", tmp_path / "a.png", code=3)
    assert "expected seconds" in run("fogbank", "--sheet-seconds", "now", "--out", tmp_path / "a.png", code=3)


def test_off_and_on_stand_side_by_side(tmp_path: Path) -> None:
    run("window", "--off-on", "--out", tmp_path / "two.exr", *SMALL)
    run("window", "--out", tmp_path / "one.exr", *SMALL)
    both, one = read_exr_layers(tmp_path / "two.exr")["rgb"], read_exr_layers(tmp_path / "one.exr")
    torch.testing.assert_close(both[:, 32:], one["rgb"])
    torch.testing.assert_close(both[:, :32], one["background"])


def test_a_tolerance_picks_the_settings(tmp_path: Path) -> None:
    outcome = RUNNER.invoke(
        app, ["shafts", "columns", "--tolerance", "0.1", "--out", str(tmp_path / "a.png"), *SMALL[:-1]]
    )
    assert outcome.exit_code == 0, outcome.output
    assert "10.00% accepted" in outcome.stderr
    assert "lamps: there are none" in outcome.stderr


def test_the_sun_can_be_moved_and_the_picture_brightened(tmp_path: Path) -> None:
    run("columns", "--out", tmp_path / "a.exr", *SMALL)
    run("columns", "--exposure", "1", "--out", tmp_path / "b.exr", *SMALL)
    run("columns", "--sun-azimuth", "90", "--sun-elevation", "40", "--out", tmp_path / "c.exr", *SMALL)
    a, b, c = (read_exr_layers(tmp_path / f"{name}.exr") for name in "abc")
    torch.testing.assert_close(b["rgb"], 2.0 * a["rgb"])
    assert torch.equal(b["transmittance"], a["transmittance"])
    assert not torch.allclose(c["in_scattering"], a["in_scattering"], rtol=0.1)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["sahara"], "no such scene file"),
        (["ridge", "--out", "a.jpg"], "a.jpg: expected a name that ends in"),
        (["ridge", "--sheet-times", "noon"], "hours of the day"),
        (["ridge", "--sheet-times", "25"], "hours of the day"),
        (["ridge", "--sun-azimuth", "3"], "go together"),
        (["lights", "--sheet-times", "6"], "no sun"),
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
