"""`cloudfit compare` as a user runs it: real tables of a tiny volume, a generated photograph, two methods, two seeds."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from cloudfit.cli import app
from cloudfit.comparison.run_record import read_run
from cloudfit.quality import QUALITIES
from render.image_files import write_png
from render.procedural_cloud import build_cumulus
from render.volume_files import write_volume
from tests.system.test_command_line import CAMERA, IN_A_PROCESS, PROJECT, TINY, clear_sky, cloudy_photograph, parse

METHODS = ["--method", "genetic", "--method", "crs2_lm+sbplx"]


@pytest.fixture
def studio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a volume and a photograph of clouds."""
    monkeypatch.setitem(QUALITIES, "draft", TINY)
    write_volume(tmp_path / "cloud.npz", build_cumulus(16))
    (tmp_path / "photos").mkdir()
    write_png(tmp_path / "photos" / "first.png", cloudy_photograph(1))
    return tmp_path


def arguments(studio: Path, evaluations: int = 60, seeds: int = 2) -> list[str]:
    place = ["--volume", str(studio / "cloud.npz"), "--out", str(studio / "out"), "--quality", "draft", *CAMERA]
    limits = ["--seeds", str(seeds), "--max-evaluations", str(evaluations)]
    return ["compare", str(studio / "photos"), *place, *METHODS, *limits]


def compare(studio: Path, *more: str, **limits: int) -> Result:
    return CliRunner().invoke(app, [*arguments(studio, **limits), *more])


def test_methods_are_compared_kept_and_reported(studio: Path) -> None:
    first = compare(studio, "--synthetic", "1", "--json")
    assert first.exit_code == 0, first.stderr
    document = parse(first)
    out = studio / "out"
    assert document["page"] == str(out / "index.html")
    assert {row["method"] for row in document["methods"]} == {"genetic", "crs2_lm+sbplx"}
    assert [problem["name"] for problem in document["problems"]] == ["first", "synthetic_00"]
    assert document["problems"][0]["truth_loss"] is None
    assert document["problems"][1]["truth_loss"] < document["problems"][1]["best_loss"]
    for row in document["methods"]:
        assert row["runs"] == 4
        assert row["evaluations"] == 60
        assert 0.0 < row["objective_seconds"] < row["seconds"]
        assert 0.0 < row["aocc_evaluations"] < 1.0

    runs = {path: read_run(path) for path in (out / "runs").rglob("*.json")}
    assert len(runs) == 8
    assert all(0.0 < run.loss < 2.0 and run.loss == pytest.approx(run.trace.loss[-1]) for run in runs.values())
    with (out / "runs.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == 8
    log = json.loads((out / "ioh" / "genetic" / "IOHprofiler_f1_first.json").read_text())
    assert (out / "ioh" / "genetic" / log["scenarios"][0]["path"]).read_text().count("evaluations raw_y") == 2
    html = (out / "index.html").read_text(encoding="utf-8")
    assert all(
        (out / name).is_file() and name in html for name in ("pictures/first-photograph.png", "pictures/first-best.png")
    )

    written = {path: path.stat().st_mtime_ns for path in runs}
    again = compare(studio, "--synthetic", "1")
    assert again.exit_code == 0
    assert "8 of 8 runs have been done before" in again.stderr
    assert {path: path.stat().st_mtime_ns for path in runs} == written
    assert again.stdout.splitlines()[-1] == f"page: {out / 'index.html'}"
    more = compare(studio, "--synthetic", "1", "--quiet", seeds=3)
    assert (more.exit_code, more.stderr) == (0, "")
    assert len(list((out / "runs").rglob("*.json"))) == 12


def test_a_photograph_without_clouds_is_left_out_and_said(studio: Path) -> None:
    write_png(studio / "photos" / "bright.png", clear_sky())
    result = compare(studio, evaluations=20)
    assert result.exit_code == 1
    assert "bright is left out" in result.stderr
    assert (studio / "out" / "index.html").is_file()


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_ctrl_c_loses_the_run_under_way_alone_and_the_next_call_goes_on(studio: Path, jobs: str) -> None:
    limits = {"evaluations": 400, "seeds": 40}
    command = [sys.executable, "-c", IN_A_PROCESS, *arguments(studio, **limits), "--jobs", jobs]
    runs = studio / "out" / "runs"
    with subprocess.Popen(
        command, cwd=PROJECT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        deadline = time.monotonic() + 60.0
        while len(list(runs.rglob("seed-*.json"))) < 3 and time.monotonic() < deadline:
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers too
        _, errors = process.communicate(timeout=60.0)
    assert process.returncode == 130, errors
    assert "run the same command again to go on" in errors
    assert "Traceback" not in errors
    finished = {path: path.stat().st_mtime_ns for path in runs.rglob("seed-*.json")}
    assert 3 <= len(finished) < 80
    assert not list(runs.rglob("*.part*"))
    records = {path: read_run(path) for path in finished}
    assert not any(record.failed for record in records.values())
    few = max(record.seed for record in records.values()) + 1
    assert few < 40, "stopped long before its end"
    limits["seeds"] = few
    resumed = compare(studio, **limits)
    assert resumed.exit_code == 0, resumed.stderr
    assert f"{len(finished)} of {2 * few} runs have been done before" in resumed.stderr or len(finished) == 2 * few
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    assert len(list(runs.rglob("seed-*.json"))) == 2 * few
