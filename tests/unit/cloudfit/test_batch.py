import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from cloudfit.batch import BatchReport, BatchSettings, SilentListener, available_cores, fit_folder, limit_threads
from cloudfit.fit_types import FitOptions
from cloudfit.one_photograph import Outcome
from cloudfit.result import read_result
from render.errors import InputError, ParameterError, StoreError
from tests.support.fake_stages import FAKE_STAGES, refuse_stack
from tests.support.hand_made_fit import small_scene, write_photograph

SCENE, OPTIONS = small_scene(), FitOptions()


def photographs(folder: Path, *names: str) -> list[Path]:
    return [write_photograph(folder / f"{name}.png") for name in names]


def run(files: list[Path], out: Path, force: bool = False, options: FitOptions = OPTIONS) -> BatchReport:
    return fit_folder(files, SCENE, options, BatchSettings(out, force=force), stages=FAKE_STAGES)


def read_names(folder: Path) -> list[str]:
    log = folder / "log.txt"
    return [line.split()[0] for line in log.read_text().splitlines()] if log.exists() else []


def test_one_bad_photograph_never_ends_a_batch(tmp_path: Path) -> None:
    files = photographs(tmp_path, "a", "empty", "surprise", "b")
    (tmp_path / "broken.png").write_bytes(b"")
    report = run([tmp_path / "broken.png", *files], tmp_path / "out")
    assert [outcome.status for outcome in report.outcomes] == ["failed", "done", "no_cloud", "failed", "done"]
    assert (report.count("done"), report.count("failed"), report.count("no_cloud")) == (2, 2, 1)
    assert not report.interrupted
    for outcome in report.outcomes:
        assert read_result(outcome.job.folder)["status"] == outcome.status
    page = report.page.read_text(encoding="utf-8")
    assert all(f"{name}/index.html" in page for name in ("broken", "a", "empty", "surprise", "b"))
    assert len((tmp_path / "out" / ".tables" / "calls.txt").read_text().splitlines()) == 1


def test_a_second_run_does_nothing_but_what_failed(tmp_path: Path) -> None:
    files = photographs(tmp_path, "a", "empty")
    first = run(files, tmp_path / "out")
    second = run(files, tmp_path / "out")
    assert second.did_nothing
    assert not first.did_nothing
    assert second.stack is None, "the stack is not needed"
    assert read_names(tmp_path) == ["a", "empty"], "nothing was read again"
    assert [replace(outcome, kept=True) for outcome in first.outcomes] == list(second.outcomes)
    failed = photographs(tmp_path, "surprise")
    run(failed, tmp_path / "out")
    run(failed, tmp_path / "out")
    assert read_names(tmp_path).count("surprise") == 2


def test_other_options_another_photograph_a_missing_file_or_force_fit_again(tmp_path: Path) -> None:
    files = photographs(tmp_path, "a")
    out = tmp_path / "out"
    run(files, out)
    assert not run(files, out, options=FitOptions(seed=1)).did_nothing
    assert run(files, out, options=FitOptions(seed=1)).did_nothing
    assert not run(files, out, force=True, options=FitOptions(seed=1)).did_nothing
    (out / "a" / "best.exr").unlink()
    assert not run(files, out, options=FitOptions(seed=1)).did_nothing
    write_photograph(files[0], blue=0.5)
    assert not run(files, out, options=FitOptions(seed=1)).did_nothing


def test_ctrl_c_keeps_what_is_finished(tmp_path: Path) -> None:
    files = photographs(tmp_path, "a", "stop", "b")
    report = run(files, tmp_path / "out")
    assert report.interrupted
    assert [outcome.job.photograph.stem for outcome in report.outcomes] == ["a"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"a", ".tables", "index.html"}
    assert read_names(tmp_path) == ["a", "stop"]


def test_an_interrupted_search_is_kept_on_disk_but_tried_again(tmp_path: Path) -> None:
    files = photographs(tmp_path, "half", "b")
    report = run(files, tmp_path / "out")
    assert report.interrupted
    assert [outcome.interrupted for outcome in report.outcomes] == [True]
    assert (tmp_path / "out" / "half" / "best.png").exists()
    assert not run(files[:1], tmp_path / "out").did_nothing


def test_a_batch_without_a_stack_ends_with_its_reason(tmp_path: Path) -> None:
    stages = replace(FAKE_STAGES, prepare_stack=refuse_stack)
    with pytest.raises(StoreError, match="no space left"):
        fit_folder(photographs(tmp_path, "a"), SCENE, OPTIONS, BatchSettings(tmp_path / "out"), stages=stages)


def test_folders_that_cannot_be_made_and_no_jobs_are_refused(tmp_path: Path) -> None:
    files = photographs(tmp_path, "a")
    with pytest.raises(InputError, match="cannot make the output folder"):
        run(files, files[0] / "out")
    with pytest.raises(ParameterError, match="at least one job"):
        fit_folder(files, SCENE, OPTIONS, BatchSettings(tmp_path / "out", jobs=0), stages=FAKE_STAGES)


class Witness(SilentListener):
    """Writes down what it is told."""

    def __init__(self) -> None:
        self.plan: tuple[int, int] | None = None
        self.subjects: set[str] = set()
        self.outcomes: list[Outcome] = []

    def planned(self, total: int, kept: int) -> None:
        self.plan = (total, kept)

    def stage(self, subject: str, stage: str, share: float) -> None:
        self.subjects.add(subject)

    def finished(self, outcome: Outcome) -> None:
        self.outcomes.append(outcome)


def test_the_listener_hears_of_everything(tmp_path: Path) -> None:
    run(photographs(tmp_path, "a"), tmp_path / "out")
    witness = Witness()
    files = photographs(tmp_path, "a", "b")
    fit_folder(files, SCENE, OPTIONS, BatchSettings(tmp_path / "out"), listener=witness, stages=FAKE_STAGES)
    assert witness.plan == (2, 1)
    assert witness.subjects == {"b.png"}
    assert [(outcome.job.photograph.stem, outcome.kept) for outcome in witness.outcomes] == [("a", True), ("b", False)]


def test_the_threads_are_never_raised() -> None:
    before = torch.get_num_threads()
    assert available_cores() >= 1
    limit_threads(10_000)
    assert torch.get_num_threads() == before
    try:
        limit_threads(1)
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(before)


def test_the_result_is_json_that_every_parser_reads(tmp_path: Path) -> None:
    run(photographs(tmp_path, "a"), tmp_path / "out")

    def refuse(name: str) -> None:
        raise AssertionError(name)

    document = json.loads((tmp_path / "out" / "a" / "result.json").read_text(), parse_constant=refuse)
    assert document["status"] == "done"
