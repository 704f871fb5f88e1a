import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cloudfit.photograph import read_photograph
from cloudfit.quality import QUALITIES
from cloudfit.result import SCHEMA, finite_or_none, read_result, result_matches, write_result
from cloudfit.result_document import describe_fit, describe_reason
from render.errors import ResultError
from tests.support.hand_made_fit import (
    make_analysis,
    make_circumstances,
    make_fit,
    make_question,
    make_space,
    small_scene,
    write_photograph,
)

Document = dict[str, Any]


@pytest.fixture
def document(tmp_path: Path) -> Document:
    photograph = write_photograph(tmp_path / "photo.png")
    fit = make_fit(make_analysis(read_photograph(photograph)))
    return describe_fit(fit, make_space(), make_circumstances(photograph))


def test_a_result_comes_back_as_written(tmp_path: Path, document: Document) -> None:
    path = tmp_path / "result.json"
    write_result(path, document)
    assert read_result(path) == document
    assert read_result(tmp_path) == document, "the folder stands for its result"
    assert not list(tmp_path.glob("*.part*"))


def test_a_missing_result_is_named(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match=r"nothing\.json: there is no such file"):
        read_result(tmp_path / "nothing.json")


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_truncated_result_is_refused(tmp_path: Path, document: Document, share: float) -> None:
    path = tmp_path / "result.json"
    write_result(path, document)
    text = path.read_text()
    path.write_text(text[: int(share * (len(text) - 3))])
    with pytest.raises(ResultError, match=r"result\.json: truncated, damaged or not JSON"):
        read_result(path)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"\xff\xfe\x00", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b"[1, 2]", "does not name its schema"),
        (b'{"a": 1}', "does not name its schema"),
        (b'{"schema": "cloudfit result 0"}', "expected the schema"),
        (b'{"schema": ["cloudfit result 1"]}', "expected the schema"),
        (f'{{"schema": "{SCHEMA}", "status": "perhaps"}}'.encode(), "expected a status"),
        (f'{{"schema": "{SCHEMA}", "status": "done"}}'.encode(), "the key reason is missing"),
    ],
)
def test_a_foreign_file_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "result.json"
    path.write_bytes(content)
    with pytest.raises(ResultError, match=reason):
        read_result(path)


def without(document: Document, dotted: str) -> Document:
    copy: Document = json.loads(json.dumps(document))
    *levels, last = dotted.split(".")
    place: Any = copy
    for level in levels:
        place = place[int(level) if level.isdigit() else level]
    del place[last]
    return copy


@pytest.mark.parametrize(
    "key",
    ["fingerprint", "scene.camera.type", "sunlight", "candidates.1.loss", "candidates.0.parameters.albedo.lower"],
)
def test_a_missing_key_is_named(tmp_path: Path, document: Document, key: str) -> None:
    path = tmp_path / "result.json"
    path.write_text(json.dumps(without(document, key)))
    with pytest.raises(ResultError, match=f"{key.split('.')[-1]}.* is missing"):
        read_result(path)


CHANGES: dict[str, Callable[[Document], object]] = {
    "another type": lambda d: d["scene"].update(sun_azimuth_deg="south"),
    "true for a number": lambda d: d["candidates"][0].update(loss=True),
    "not a list": lambda d: d.update(candidates={}),
    "no candidate": lambda d: d.update(candidates=[]),
    "a file elsewhere": lambda d: d["files"].update(best="../best.png"),
    "a file that is a folder": lambda d: d["files"].update(best=".."),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_does_not_fit_the_schema_is_neither_read_nor_written(
    tmp_path: Path, document: Document, change: str
) -> None:
    path = tmp_path / "result.json"
    CHANGES[change](document)
    path.write_text(json.dumps(document))
    with pytest.raises(ResultError, match=r"result\.json"):
        read_result(path)
    with pytest.raises(ResultError, match=r"result\.json"):
        write_result(path, document)


def test_numbers_that_are_none_are_refused(tmp_path: Path, document: Document) -> None:
    document["search"]["evaluations_per_second"] = float("nan")
    with pytest.raises(ResultError, match="cannot write"):
        write_result(tmp_path / "result.json", document)
    path = tmp_path / "result.json"
    path.write_text('{"schema": NaN}')
    with pytest.raises(ResultError, match="NaN"):
        read_result(path)
    assert finite_or_none(1.5) == 1.5
    assert finite_or_none(float("inf")) is None


def test_the_fingerprint_sees_everything_that_a_result_depends_on() -> None:
    question = make_question()
    assert question.fingerprint() == make_question().fingerprint()
    scene = small_scene()
    others = [
        make_question("01"),
        replace(question, mask_sha256="00"),
        make_question(seed=1),
        make_question(transfer="none"),
        make_question(optimiser="crs2_lm"),
        make_question(air_refinements=0),
        make_question(seconds=3.0),
        make_question(quality=QUALITIES["draft"]),
        make_question(optical_depths=(0.05, 20.0)),
        make_question(scene=small_scene(41.0)),
        make_question(scene=replace(scene, camera=scene.camera.resized(9, 6))),
    ]
    assert question.fingerprint() not in {other.fingerprint() for other in others}
    assert len({other.fingerprint() for other in others}) == len(others)


def test_a_result_matches_only_its_own_question_with_all_its_files(tmp_path: Path, document: Document) -> None:
    path = tmp_path / "result.json"
    document["files"] = {"best": "best.png"}
    write_result(path, document)
    assert not result_matches(path, document["fingerprint"]), "best.png is missing"
    (tmp_path / "best.png").touch()
    assert result_matches(path, document["fingerprint"])
    assert result_matches(tmp_path, document["fingerprint"])
    assert not result_matches(path, "0" * 64)
    path.write_text(path.read_text()[:-20])
    assert not result_matches(path, document["fingerprint"])


def test_what_failed_or_was_interrupted_is_tried_again(tmp_path: Path, document: Document) -> None:
    path = tmp_path / "result.json"
    write_result(path, {**document, "interrupted": True})
    assert not result_matches(path, document["fingerprint"])
    for status, kept in (("failed", False), ("no_cloud", True)):
        write_result(path, describe_reason(status, "why", make_circumstances(tmp_path / "photo.png")))
        assert result_matches(path, document["fingerprint"]) is kept
