import shutil
from pathlib import Path
from typing import Any

import pytest
import typer

from cloudfit import example_photographs
from cloudfit.batch import BatchReport, BatchSettings
from cloudfit.commands import demo as demo_module
from cloudfit.commands import options as o
from tests.support.hand_made_fit import write_photograph


def test_the_demo_fits_the_examples_and_names_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    examples = [write_photograph(tmp_path / "rendered_noon.png")]
    calls: list[tuple[Any, ...]] = []

    def stand_in(*arguments: Any) -> BatchReport:
        calls.append(arguments)
        return BatchReport((), tmp_path / "demo" / "results" / "index.html", None, False)

    def copy(folder: Path) -> list[Path]:
        folder.mkdir(parents=True)
        return [Path(shutil.copy(path, folder)) for path in examples]

    monkeypatch.setattr(demo_module, "run_batch", stand_in)
    monkeypatch.setattr(example_photographs, "write_examples", copy)
    with pytest.raises(typer.Exit) as caught:
        demo_module.demo(tmp_path / "demo")
    assert caught.value.exit_code == 0
    photographs, masks, scene, _, settings, _ = calls[0]
    assert photographs == [tmp_path / "demo" / "photographs" / "rendered_noon.png"]
    assert masks == {}
    assert isinstance(scene, o.SceneChoice)
    assert scene.volume is None, "the procedural cumulus"
    assert settings == BatchSettings(tmp_path / "demo" / "results")
    streams = capsys.readouterr()
    assert "index.html" in streams.out
    assert "rendered by this project itself" in streams.err
