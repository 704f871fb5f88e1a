import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from cloudfit.photograph import read_photograph
from cloudfit.result import read_result, result_matches
from cloudfit.result_document import describe_fit, describe_reason
from cloudfit.result_folder import (
    folder_names,
    remove_temporary_folders,
    replaced_folder,
    write_fit,
    write_reason,
)
from render.errors import ResultError
from render.image_files import read_exr_layers, read_image, read_mask_png
from tests.support.hand_made_fit import make_analysis, make_circumstances, make_fit, make_space, write_photograph

PROJECT = Path(__file__).resolve().parents[3]


def write_small_fit(folder: Path, losses: tuple[float, ...] = (0.6, 0.7)) -> dict[str, object]:
    photograph = folder.parent / "photo.png"
    if not photograph.exists():
        write_photograph(photograph)
    fit = make_fit(make_analysis(read_photograph(photograph)), losses=losses)
    document = describe_fit(fit, make_space(), make_circumstances(photograph))
    write_fit(folder, fit, document, "token")
    return document


def test_a_fit_leaves_all_its_files(tmp_path: Path) -> None:
    document = write_small_fit(tmp_path / "photo")
    folder = tmp_path / "photo"
    assert read_result(folder) == document
    assert result_matches(folder, str(document["fingerprint"]))
    names = {file.name for file in folder.iterdir()}
    assert {"result.json", "index.html", "best.png", "best.exr", "candidate_2.png", "mask.png", "sky.png"} <= names
    assert not list(tmp_path.glob(".*"))


def test_the_layers_sum_to_the_picture_and_the_mask_holds_labels(tmp_path: Path) -> None:
    write_small_fit(tmp_path / "photo")
    layers = read_exr_layers(tmp_path / "photo" / "best.exr")
    assert set(layers) == {"rgb", "single", "multiple", "ambient", "sky", "transmittance"}
    total = layers["single"] + layers["multiple"] + layers["ambient"] + layers["sky"]
    assert torch.allclose(total, layers["rgb"], atol=1e-6)
    assert not torch.allclose(total - layers["ambient"], layers["rgb"], atol=1e-2)
    assert set(read_mask_png(tmp_path / "photo" / "mask.png").flatten().tolist()) == {85, 170, 255}
    shown = read_image(tmp_path / "photo" / "photograph.png").pixels
    assert torch.allclose(shown, read_photograph(tmp_path / "photo.png").pixels, atol=1e-3)


def test_a_second_fit_replaces_the_first_and_leaves_foreign_files_alone(tmp_path: Path) -> None:
    folder = tmp_path / "photo"
    write_small_fit(folder, (0.6, 0.7))
    (folder / "notes.txt").write_text("mine")
    document = write_small_fit(folder, (0.5,))
    assert read_result(folder) == document
    assert not (folder / "candidate_2.png").exists(), "the old fit had two answers"
    assert (folder / "notes.txt").read_text() == "mine"


def test_a_reason_replaces_a_fit(tmp_path: Path) -> None:
    folder = tmp_path / "photo"
    write_small_fit(folder)
    circumstances = make_circumstances(tmp_path / "photo.png")
    write_reason(folder, None, describe_reason("failed", "why", circumstances), "token")
    assert {file.name for file in folder.iterdir()} == {"result.json", "index.html"}
    photograph = read_photograph(tmp_path / "photo.png")
    write_reason(folder, photograph, describe_reason("no_cloud", "why", circumstances), "token")
    assert (folder / "photograph.png").exists()


def test_a_file_in_the_way_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / "photo").write_text("mine")
    with pytest.raises(ResultError, match="found a file"), replaced_folder(tmp_path / "photo", "token"):
        pass
    assert (tmp_path / "photo").read_text() == "mine"


def test_an_error_while_writing_leaves_the_old_result(tmp_path: Path) -> None:
    folder = tmp_path / "photo"
    document = write_small_fit(folder)

    def write_badly() -> None:
        with replaced_folder(folder, "token") as temporary:
            (temporary / "result.json").write_text("{")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_badly()
    assert read_result(folder) == document
    assert not list(tmp_path.glob(".*"))


def test_only_own_and_abandoned_leftovers_are_removed(tmp_path: Path) -> None:
    for name in (".photo.mine.part", ".photo.theirs.part", ".photo.old.part"):
        (tmp_path / name).mkdir()
    long_ago = time.time() - 7200
    os.utime(tmp_path / ".photo.old.part", (long_ago, long_ago))
    remove_temporary_folders(tmp_path, "mine")
    assert {path.name for path in tmp_path.iterdir()} == {".photo.theirs.part", ".photo.old.part"}
    with replaced_folder(tmp_path / "photo", "token"):
        pass
    assert {path.name for path in tmp_path.iterdir()} == {"photo", ".photo.theirs.part"}


def test_a_writer_with_the_same_token_takes_over_from_one_that_was_killed(tmp_path: Path) -> None:
    leftover = tmp_path / ".photo.token.part"
    leftover.mkdir()
    (leftover / "half").touch()
    write_small_fit(tmp_path / "photo")
    assert not leftover.exists()
    assert not (tmp_path / "photo" / "half").exists()


def test_folders_have_the_stems_and_collisions_whole_names() -> None:
    paths = [Path(name) for name in ("x/a.jpg", "x/a.png", "x/b.jpg", "y/A.jpg", "x/index.html.png")]
    assert list(folder_names(paths).values()) == ["a.jpg", "a.png", "b", "A.jpg-2", "index.html.png"]


WRITER = """
import sys
from pathlib import Path
from tests.unit.cloudfit.test_result_folder import write_small_fit
folder = Path(sys.argv[1])
print("ready", flush=True)
while True:
    write_small_fit(folder)
    print("written", flush=True)
"""


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.05, 0.11])
def test_a_process_killed_at_any_moment_leaves_a_whole_result_or_none(tmp_path: Path, delay: float) -> None:
    folder = tmp_path / "photo"
    command = [sys.executable, "-c", WRITER, str(folder)]
    with subprocess.Popen(command, cwd=PROJECT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        if delay > 0.05:
            assert process.stdout.readline() == "written\n"
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
    if (folder / "result.json").exists():
        document = read_result(folder)
        assert result_matches(folder, document["fingerprint"]), "whole, with every file"
