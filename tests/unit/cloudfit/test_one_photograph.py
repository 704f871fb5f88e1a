from dataclasses import replace
from pathlib import Path

import pytest
import torch

from cloudfit.fit_types import FitOptions
from cloudfit.one_photograph import (
    Job,
    StackSource,
    StackUnavailableError,
    ask,
    file_sha256,
    kept_outcome,
    record_reason,
    searched_space,
    treat_photograph,
)
from cloudfit.photograph import read_photograph
from cloudfit.result import read_result
from render.errors import StoreError
from render.image_files import write_mask_png
from render.scattering_stack import ScatteringStack
from tests.support.fake_stages import FAKE_STAGES, one_pixel_tables, refuse_stack
from tests.support.hand_made_fit import make_analysis, small_scene, write_photograph

SCENE, OPTIONS = small_scene(), FitOptions()


def make_job(folder: Path, name: str = "sky.png") -> Job:
    photograph = write_photograph(folder / name)
    return Job(photograph, None, folder / "out")


def make_source(folder: Path) -> StackSource:
    return StackSource(SCENE, OPTIONS, folder / "tables", FAKE_STAGES)


def test_a_photograph_is_fitted_and_its_outcome_told(tmp_path: Path) -> None:
    job, stages = make_job(tmp_path), []
    question = ask(job, SCENE, OPTIONS)
    outcome = treat_photograph(job, question, make_source(tmp_path), "token", lambda stage, share: stages.append(stage))
    assert (outcome.status, outcome.loss, outcome.floor, outcome.wasserstein) == ("done", 0.6, 0.3, 12.5)
    assert stages == ["reading", "finding clouds", "stack", "search", "writing"]
    document = read_result(job.folder)
    assert document["fingerprint"] == question.fingerprint()
    assert set(document["seconds"]) == {"reading", "analysis", "search", "pictures", "total", "stack"}
    parts = [value for name, value in document["seconds"].items() if name not in ("total", "stack")]
    assert document["seconds"]["total"] == pytest.approx(sum(parts))


def test_what_was_done_is_kept_until_the_question_changes(tmp_path: Path) -> None:
    job = make_job(tmp_path)
    question = ask(job, SCENE, OPTIONS)
    assert kept_outcome(job, question) is None
    outcome = treat_photograph(job, question, make_source(tmp_path), "token")
    assert kept_outcome(job, question) == replace(outcome, kept=True)
    assert kept_outcome(job, ask(job, SCENE, FitOptions(seed=1))) is None
    write_photograph(job.photograph, blue=0.9)
    assert kept_outcome(job, ask(job, SCENE, OPTIONS)) is None


@pytest.mark.parametrize(
    ("name", "status", "reason"),
    [("empty.png", "no_cloud", "expected clouds"), ("surprise.png", "failed", "ZeroDivisionError: one over nothing")],
)
def test_what_goes_wrong_becomes_a_reason_on_disk(tmp_path: Path, name: str, status: str, reason: str) -> None:
    job = make_job(tmp_path, name)
    outcome = treat_photograph(job, ask(job, SCENE, OPTIONS), make_source(tmp_path), "token")
    assert outcome.status == status
    assert reason in str(outcome.reason)
    assert ("Traceback" in outcome.details) is (name == "surprise.png")
    assert read_result(job.folder)["reason"] == outcome.reason
    assert (job.folder / "photograph.png").exists()


@pytest.mark.parametrize("content", [b"", b"no image", None])
def test_an_unreadable_photograph_fails_with_its_name(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "broken.jpg"
    if content is not None:
        path.write_bytes(content)
    elif not path.exists():
        path.mkdir()
    job = Job(path, None, tmp_path / "out")
    source = StackSource(SCENE, OPTIONS, tmp_path / "tables", replace(FAKE_STAGES, read=read_photograph))
    outcome = treat_photograph(job, ask(job, SCENE, OPTIONS), source, "token")
    assert outcome.status == "failed"
    assert "broken.jpg" in str(outcome.reason)
    assert read_result(job.folder)["status"] == "failed"
    assert not (tmp_path / "tables").exists(), "the stack is not built for nothing"


def test_a_mask_reaches_the_analysis_and_a_damaged_one_fails(tmp_path: Path) -> None:
    job = replace(make_job(tmp_path), mask=tmp_path / "mask.png")
    labels = torch.full((6, 8), 170, dtype=torch.uint8)
    labels[0] = 255
    write_mask_png(tmp_path / "mask.png", labels)
    assert treat_photograph(job, ask(job, SCENE, OPTIONS), make_source(tmp_path), "token").status == "done"
    document = read_result(job.folder)
    assert document["mask"]["cloud_pixels"] == 8
    assert document["mask"]["sha256"] == file_sha256(tmp_path / "mask.png")
    (tmp_path / "mask.png").write_bytes(b"")
    outcome = treat_photograph(job, ask(job, SCENE, OPTIONS), make_source(tmp_path), "token")
    assert outcome.status == "failed"
    assert "mask.png" in str(outcome.reason)


def test_a_stack_that_cannot_be_had_ends_the_batch(tmp_path: Path) -> None:
    job = make_job(tmp_path)
    source = StackSource(SCENE, OPTIONS, tmp_path, replace(FAKE_STAGES, prepare_stack=refuse_stack))
    with pytest.raises(StackUnavailableError) as caught:
        treat_photograph(job, ask(job, SCENE, OPTIONS), source, "token")
    assert isinstance(caught.value.__cause__, StoreError)
    assert not job.folder.exists()


def test_the_stack_is_made_once(tmp_path: Path) -> None:
    source = make_source(tmp_path)
    assert source.get(lambda stage, share: None) is source.get(lambda stage, share: None)
    assert len((tmp_path / "tables" / "calls.txt").read_text().splitlines()) == 1


def test_ctrl_c_passes_through_and_leaves_nothing(tmp_path: Path) -> None:
    job = make_job(tmp_path, "stop.png")
    with pytest.raises(KeyboardInterrupt):
        treat_photograph(job, ask(job, SCENE, OPTIONS), make_source(tmp_path), "token")
    assert not job.folder.exists()


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    job = make_job(tmp_path)
    job.folder.write_text("a file in the way")
    outcome = treat_photograph(job, ask(job, SCENE, OPTIONS), make_source(tmp_path), "token")
    assert outcome.status == "failed"
    assert "found a file" in str(outcome.reason)
    outcome = record_reason(job, ask(job, SCENE, OPTIONS), ("no_cloud", "why"), "token")
    assert outcome.status == "failed", "a reason that is not on disk is no success"


def test_hashes_of_files_that_cannot_be_read_are_none(tmp_path: Path) -> None:
    assert file_sha256(None) is None
    assert file_sha256(tmp_path) is None
    (tmp_path / "empty").touch()
    assert file_sha256(tmp_path / "empty") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"


def test_the_searched_space_is_that_of_the_fit(tmp_path: Path) -> None:
    analysis = make_analysis(read_photograph(write_photograph(tmp_path / "sky.png")))
    stack = ScatteringStack(one_pixel_tables())
    space = searched_space(analysis, stack, FitOptions(ambient="free"))
    by_name = {parameter.name: parameter for parameter in space.parameters}
    assert by_name["extinction"].lower == pytest.approx(0.01)
    assert by_name["asymmetry"].upper == pytest.approx(0.9)
    assert "ambient_red" in by_name
