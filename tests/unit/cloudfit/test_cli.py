import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cloudfit import __version__
from cloudfit.cli import app

PROJECT = Path(__file__).resolve().parents[3]
COMMANDS = ("fit", "precompute", "render", "fog", "shafts", "compare", "info", "demo")
RUNNER = CliRunner(env={"COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"})


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_teaches(command: str) -> None:
    run = RUNNER.invoke(app, [command, "--help"])
    assert run.exit_code == 0
    text = " ".join(run.output.split())
    assert "Examples:" in text
    assert f"cloudfit {command}" in text
    assert "130 interrupted" in text


def test_the_program_lists_its_commands_and_its_version() -> None:
    overview = RUNNER.invoke(app, ["--help"]).output
    assert all(command in overview for command in COMMANDS)
    assert RUNNER.invoke(app, ["--version"]).output == f"cloudfit {__version__}\n"


def test_fit_has_every_option_that_was_promised() -> None:
    text = RUNNER.invoke(app, ["fit", "--help"]).output
    names = (
        "volume out mask sun-azimuth sun-elevation camera-azimuth camera-elevation camera-fov camera-distance camera-width "
        "camera-height camera-type seed jobs transfer ambient quality optimiser candidates max-seconds resume force tables "
        "quiet verbose json loss coarse-air"
    )
    assert not [name for name in names.split() if f"--{name}" not in text]


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit"],
        ["fit", "x.jpg", "--quality", "perfect"],
        ["fit", "x.jpg", "--sun-elevation", "91"],
        ["fit", "x.jpg", "--jobs", "0"],
        ["fit", "x.jpg", "--camera-fov", "wide"],
        ["render"],
        ["paint"],
    ],
)
def test_wrong_usage_is_code_2(arguments: list[str]) -> None:
    assert RUNNER.invoke(app, arguments).exit_code == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fit", "gone.jpg"], "gone.jpg: no such file"),
        (["fit", str(PROJECT / "cloudfit" / "examples"), "--loss", "l7"], "no loss is called 'l7'"),
        (["compare", "gone.jpg"], "gone.jpg: no such file"),
        (["compare"], "nothing to compare on"),
        (["compare", "--synthetic", "1", "--method", "best"], "no optimiser is called 'best'"),
        (["info", "gone.npz"], "gone.npz"),
        (["render", "gone/result.json", "--out", "x.png"], "there is no such file"),
        (["precompute", "--volume", "gone.vol"], "gone.vol"),
    ],
)
def test_bad_input_is_code_3_and_one_sentence(arguments: list[str], words: str) -> None:
    run = RUNNER.invoke(app, arguments)
    assert run.exit_code == 3
    assert words in run.stderr
    assert run.stdout == ""
    assert len(run.stderr.strip().splitlines()) <= 2


def test_help_does_not_wait_for_torch() -> None:
    check = "import sys, cloudfit.cli; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], cwd=PROJECT, check=False).returncode == 0
