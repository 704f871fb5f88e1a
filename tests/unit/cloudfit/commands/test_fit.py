import json
from pathlib import Path

import pytest

from cloudfit.batch import BatchReport, BatchSettings, fit_folder
from cloudfit.commands.console import ALL_DONE, INTERRUPTED, SOME_FAILED, Speaker
from cloudfit.commands.fit import Watcher, describe_report, find_masks, tell_report
from cloudfit.fit_types import FitOptions
from render.errors import InputError
from tests.support.fake_stages import FAKE_STAGES
from tests.support.hand_made_fit import small_scene, write_photograph


def run(folder: Path, *names: str, speaker: Speaker | None = None) -> tuple[BatchReport, BatchSettings]:
    files = [write_photograph(folder / f"{name}.png") for name in names]
    settings = BatchSettings(folder / "out")
    with (speaker or Speaker(quiet=True)).progress(len(files)) as bars:
        watcher = Watcher(speaker or Speaker(quiet=True), bars)
        return fit_folder(files, small_scene(), FitOptions(), settings, {}, watcher, FAKE_STAGES), settings


def test_masks_are_found_by_stem(tmp_path: Path) -> None:
    photographs = [Path("x/a.jpg"), Path("x/b.jpg")]
    (tmp_path / "a.png").touch()
    assert find_masks(None, photographs) == {}
    assert find_masks(tmp_path, photographs) == {photographs[0]: tmp_path / "a.png"}
    assert find_masks(tmp_path / "a.png", photographs[:1]) == {photographs[0]: tmp_path / "a.png"}


def test_masks_that_serve_nobody_are_refused(tmp_path: Path) -> None:
    photographs = [Path("x/a.jpg"), Path("x/b.jpg")]
    with pytest.raises(InputError, match=r"such as a\.png"):
        find_masks(tmp_path, photographs)
    with pytest.raises(InputError, match="no such mask"):
        find_masks(tmp_path / "a.png", photographs)
    (tmp_path / "a.png").touch()
    with pytest.raises(InputError, match="one mask for 2 photographs"):
        find_masks(tmp_path / "a.png", photographs)


def test_the_table_names_every_photograph_and_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report, settings = run(tmp_path, "a", "empty")
    assert tell_report(report, settings, Speaker(), as_json=False) == ALL_DONE, "no cloud is no failure"
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:3] == ["photograph", "status", "loss"]
    assert lines[1].split()[:5] == ["a.png", "done", "0.600", "0.300", "12.5"]
    assert lines[2].split()[:4] == ["empty.png", "no", "cloud", "-"]
    assert lines[-1] == f"page: {tmp_path / 'out' / 'index.html'}"


def test_json_tells_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report, settings = run(tmp_path, "a", "surprise")
    assert tell_report(report, settings, Speaker(), as_json=True) == SOME_FAILED
    document = json.loads(capsys.readouterr().out)
    assert document == describe_report(report, settings)
    assert (document["done"], document["failed"], document["no_cloud"]) == (1, 1, 0)
    done, failed = document["photographs"]
    assert Path(done["result"]).is_file()
    assert Path(done["page"]).is_file()
    assert (failed["status"], failed["loss"]) == ("failed", None)


def test_an_interrupted_batch_says_how_to_go_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report, settings = run(tmp_path, "a", "stop")
    assert tell_report(report, settings, Speaker(), as_json=False) == INTERRUPTED
    assert "run the same command again" in capsys.readouterr().err


def test_the_watcher_says_what_happens_on_stderr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(tmp_path, "a", "empty", "surprise", speaker=Speaker())
    streams = capsys.readouterr()
    assert streams.out == ""
    assert "a.png: loss 0.600 (floor 0.300)" in streams.err
    assert "empty.png: no cloud" in streams.err
    assert "ZeroDivisionError: one over nothing" in streams.err
    assert "Traceback" not in streams.err
    run(tmp_path, "surprise", speaker=Speaker(verbose=True))
    assert "Traceback" in capsys.readouterr().err
    run(tmp_path, "a", "empty", speaker=Speaker())
    assert "nothing to do" in capsys.readouterr().err
    run(tmp_path, "a", "b", speaker=Speaker())
    assert "1 of 2 photographs have been done before" in capsys.readouterr().err
