"""The program as a user runs it, on a scene so small that everything is computed for real."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch
from click.testing import Result
from typer.testing import CliRunner

from cloudfit.cli import app
from cloudfit.quality import QUALITIES, Quality
from cloudfit.result import read_result
from precompute.error_budget import Effort
from render.image_files import read_exr_layers, read_image, write_mask_png, write_png
from render.procedural_cloud import build_cumulus
from render.volume_files import write_volume

PROJECT = Path(__file__).resolve().parents[2]
TINY = Quality(1.0, Effort(3, 300, 2000, 4), Effort(3, 300, 2000, 4), 3, 1.6, 100.0)
CAMERA = ["--camera-width", "32", "--camera-height", "24"]

IN_A_PROCESS = """
from cloudfit import quality
from precompute.error_budget import Effort
quality.QUALITIES["draft"] = quality.Quality(1.0, Effort(3, 300, 2000, 4), Effort(3, 300, 2000, 4), 3, 1.6, 100.0)
from cloudfit.cli import main
main()
"""


@pytest.fixture
def studio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a volume, two photographs of clouds, one of a clear sky and one that is no image."""
    monkeypatch.setitem(QUALITIES, "draft", TINY)
    write_volume(tmp_path / "cloud.npz", build_cumulus(16))
    photos = tmp_path / "photos"
    photos.mkdir()
    write_png(photos / "first.png", cloudy_photograph(1))
    write_png(photos / "second.png", cloudy_photograph(2))
    write_png(photos / "bright.png", clear_sky())
    (photos / "broken.jpg").write_bytes(b"\xff\xd8\xff\xe0 no more")
    return tmp_path


def clear_sky() -> torch.Tensor:
    """Blue, brighter towards the horizon."""
    rows = torch.linspace(0.0, 1.0, 90)[:, None, None]
    return (
        (torch.tensor([0.08, 0.2, 0.55]) * (1 - rows) + torch.tensor([0.3, 0.45, 0.7]) * rows)
        .expand(90, 120, 3)
        .clone()
    )


def cloudy_photograph(seed: int) -> torch.Tensor:
    """White discs with shading before a blue sky."""
    generator = torch.Generator().manual_seed(seed)
    image = clear_sky()
    y, x = torch.meshgrid(torch.arange(90.0), torch.arange(120.0), indexing="ij")
    for _ in range(7):
        middle_x, middle_y, radius = (torch.rand(3, generator=generator) * torch.tensor([70.0, 25.0, 10.0])).tolist()
        distance = torch.hypot(x - 25.0 - middle_x, y - 35.0 - middle_y) / (radius + 10.0)
        share = (4.0 * (1.0 - distance)).clamp(0.0, 1.0)[..., None]
        shade = (0.85 - 0.3 * (y - 25.0 - middle_y) / 30.0).clamp(0.3, 0.95)[..., None]
        image = image * (1.0 - share) + shade * share
    return image + 0.01 * torch.rand(image.shape, generator=generator)


def run(studio: Path, *arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments))


def fit(studio: Path, *more: str) -> Result:
    return run(
        studio,
        "fit",
        str(studio / "photos"),
        *("--volume", str(studio / "cloud.npz"), "--out", str(studio / "out"), "--quality", "draft", *CAMERA),
        *("--max-evaluations", "60", "--candidates", "2", *more),
    )


def parse(result: Result) -> dict[str, Any]:
    document = json.loads(result.stdout)
    assert isinstance(document, dict)
    return document


def test_a_folder_is_fitted_resumed_rendered_and_explained(studio: Path) -> None:
    first = fit(studio, "--json")
    assert first.exit_code == 1, "broken.jpg has failed"
    report = parse(first)
    statuses = {Path(photo["file"]).name: photo["status"] for photo in report["photographs"]}
    assert statuses == {"bright.png": "no_cloud", "broken.jpg": "failed", "first.png": "done", "second.png": "done"}
    assert "broken.jpg" in first.stderr
    out = studio / "out"
    result = read_result(out / "first")
    best = result["candidates"][0]
    assert 0.0 < best["loss"] < 2.0
    assert best["floor"] > 0.0
    assert all((out / "first" / name).is_file() for name in result["files"].values())
    assert "second/index.html" in (out / "index.html").read_text(encoding="utf-8")
    (tables,) = (out / ".tables").iterdir()

    written = (out / "first" / "result.json").stat().st_mtime_ns
    (studio / "photos" / "broken.jpg").unlink()
    second = fit(studio)
    assert second.exit_code == 0
    assert "nothing to do" in second.stderr
    assert (out / "first" / "result.json").stat().st_mtime_ns == written
    assert "done (kept)" in second.stdout

    again = run(studio, "render", str(out / "first"), "--out", str(studio / "again.exr"), "--quiet")
    assert (again.exit_code, again.stderr) == (0, "")
    ours, theirs = (read_exr_layers(path)["rgb"] for path in (studio / "again.exr", out / "first" / "best.exr"))
    assert torch.allclose(ours, theirs, rtol=1e-3, atol=1e-4), "the same picture from the recorded numbers"
    side = run(
        studio,
        "render",
        str(out / "first"),
        "--out",
        str(studio / "side.png"),
        "--width",
        "64",
        "--camera-azimuth",
        "90",
    )
    assert side.exit_code == 0
    assert read_image(studio / "side.png").pixels.shape == (48, 64, 3)

    for file in (out / "first", tables, studio / "cloud.npz"):
        assert run(studio, "info", str(file)).exit_code == 0
        assert "kind" in parse(run(studio, "info", str(file), "--json"))


def test_tables_are_precomputed_for_a_fit_in_two_processes_with_masks(studio: Path) -> None:
    (studio / "photos" / "broken.jpg").unlink()
    (studio / "photos" / "bright.png").unlink()
    tables = str(studio / "tables")
    scene = ["--volume", str(studio / "cloud.npz"), "--tables", tables, "--quality", "draft", *CAMERA]
    made = run(studio, "precompute", *scene, "--json")
    assert made.exit_code == 0
    assert parse(made)["reused"] is False
    report = parse(fit(studio, "--tables", tables, "--json"))
    assert report["stack"]["reused"] is True
    assert report["stack"]["file"] == parse(made)["file"]
    losses = {photo["file"]: photo["loss"] for photo in report["photographs"]}
    again = parse(fit(studio, "--tables", tables, "--json", "--jobs", "2", "--force"))
    assert {photo["file"]: photo["loss"] for photo in again["photographs"]} == pytest.approx(losses, rel=1e-6)
    assert not any(photo["kept"] for photo in again["photographs"])

    masks = studio / "masks"
    masks.mkdir()
    block = torch.zeros(90, 120, dtype=torch.bool)
    block[30:60, 30:90] = True
    write_mask_png(masks / "first.png", block)
    masked = parse(fit(studio, "--tables", tables, "--json", "--mask", str(masks)))
    assert [photo["kept"] for photo in masked["photographs"]] == [False, True], "only one photograph has a mask"
    assert read_result(studio / "out" / "first")["mask"]["source"] == "user"


def test_thin_clouds_are_searched_on_tables_of_their_own(studio: Path) -> None:
    (studio / "photos" / "broken.jpg").unlink()
    (studio / "photos" / "bright.png").unlink()
    thin = ["--tables", str(studio / "tables"), "--optical-depths", "0.01", "0.5", "--json"]
    made = parse(run(studio, "precompute", "--volume", str(studio / "cloud.npz"), "--quality", "draft", *CAMERA, *thin))
    assert (made["groups"][0]["thinnest"], made["groups"][-1]["thickest"]) == pytest.approx((0.01, 0.5), rel=1e-4)
    report = parse(fit(studio, *thin))
    assert (report["stack"]["file"], report["stack"]["reused"]) == (made["file"], True)
    assert read_result(studio / "out" / "first")["options"]["optical_depths"] == [0.01, 0.5]
    refused = fit(studio, "--optical-depths", "2", "0.1")
    assert refused.exit_code not in (0, 1)
    assert "must rise from above zero" in refused.stderr


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_ctrl_c_leaves_finished_photographs_finished_and_says_how_to_go_on(studio: Path, jobs: str) -> None:
    (studio / "photos" / "broken.jpg").unlink()
    for number in range(40):
        write_png(studio / "photos" / f"more_{number:02}.png", cloudy_photograph(number))
    command = [sys.executable, "-c", IN_A_PROCESS, "fit", str(studio / "photos"), "--out", str(studio / "out")]
    options = [
        "--volume",
        str(studio / "cloud.npz"),
        "--quality",
        "draft",
        *CAMERA,
        "--max-evaluations",
        "2000",
        "--jobs",
        jobs,
    ]
    with subprocess.Popen(
        [*command, *options],
        cwd=PROJECT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        deadline = time.monotonic() + 60.0
        while len(list((studio / "out").glob("*/result.json"))) < 2 and time.monotonic() < deadline:
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers too
        _, errors = process.communicate(timeout=60.0)
    assert process.returncode == 130
    assert "run the same command again to go on" in errors
    assert "Traceback" not in errors
    finished = list((studio / "out").glob("*/result.json"))
    assert 2 <= len(finished) < 43
    for path in finished:
        read_result(path)
    assert not list((studio / "out").glob(".*.part"))
