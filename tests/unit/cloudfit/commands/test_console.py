import json

import pytest
import typer

from cloudfit.commands.console import (
    ALL_DONE,
    BAD_INPUT,
    INTERRUPTED,
    Speaker,
    print_json,
    print_table,
    reported_errors,
    show,
)
from render.errors import PhotographError, StoreError


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (PhotographError("a[b].jpg: it is empty"), BAD_INPUT, "a[b].jpg: it is empty"),
        (StoreError("no space left"), BAD_INPUT, "no space left"),
        (PermissionError(13, "Permission denied", "x.json"), BAD_INPUT, "x.json: Permission denied"),
        (KeyboardInterrupt(), INTERRUPTED, "interrupted; go on like this"),
    ],
)
def test_errors_become_one_sentence_and_a_code(
    capsys: pytest.CaptureFixture[str], error: BaseException, code: int, words: str
) -> None:
    with pytest.raises(typer.Exit) as caught, reported_errors(Speaker(), "go on like this"):
        raise error
    assert caught.value.exit_code == code
    streams = capsys.readouterr()
    assert words in streams.err
    assert "Traceback" not in streams.err
    assert streams.out == ""


def test_errors_that_are_not_ours_pass_through() -> None:
    with pytest.raises(ZeroDivisionError), reported_errors(Speaker()):
        raise ZeroDivisionError


def test_quiet_is_silent_but_for_errors(capsys: pytest.CaptureFixture[str]) -> None:
    Speaker(quiet=True).say("hello")
    assert capsys.readouterr().err == ""
    Speaker(quiet=True).warn("trouble")
    assert "trouble" in capsys.readouterr().err
    Speaker().say("hello [bold]")
    streams = capsys.readouterr()
    assert streams.err == "hello [bold]\n"
    assert streams.out == ""


def test_bars_say_nothing_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with Speaker().progress(2) as bars:
        bars.stage("search [x]", 0.5)
        bars.finished()
    assert capsys.readouterr().err.strip() == ""


def test_tables_are_whole_lines_in_a_pipe(capsys: pytest.CaptureFixture[str]) -> None:
    name = "x" * 300
    print_table(["photograph", "loss"], [[name, "0.5"], ["[red]", "0.25"]])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert lines[1].split() == [name, "0.5"]
    assert lines[2].split() == ["[red]", "0.25"]


def test_json_is_one_document_without_numbers_that_are_none(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"a": [1, "ü"]})
    assert json.loads(capsys.readouterr().out) == {"a": [1, "ü"]}
    with pytest.raises(ValueError, match="JSON compliant"):
        print_json(float("nan"))


def test_missing_numbers_are_dashes() -> None:
    assert (show(None, ".2f"), show(0.456, ".2f")) == ("-", "0.46")
    assert ALL_DONE == 0
