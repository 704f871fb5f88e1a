import inspect
import json
from dataclasses import replace
from pathlib import Path

import pytest

from cloudfit.commands.compare import (
    Watcher,
    choose_methods,
    compare,
    list_problems,
    list_scenes,
    parse_sun,
    run_comparison,
    tell_comparison,
)
from cloudfit.commands.console import ALL_DONE, INTERRUPTED, SOME_FAILED, Speaker
from cloudfit.commands.options import SceneChoice
from cloudfit.comparison.compare import EVALUATIONS, SEEDS, Comparison, Settings
from cloudfit.comparison.experiment import ExperimentReport
from cloudfit.fit_types import FitOptions
from cloudfit.optimisers import OPTIMISERS
from render.errors import InputError, ParameterError
from render.procedural_cloud import build_cumulus
from render.volume_files import write_volume
from tests.support.comparison import BowlSource, make_run
from tests.support.hand_made_fit import write_photograph


def compare_bowls(out: Path, *names: str, speaker: Speaker | None = None) -> Comparison:
    settings = Settings(out, evaluations=30, seeds=2)
    return run_comparison(
        [BowlSource(name) for name in names], choose_methods(["genetic"]), settings, speaker or Speaker(True)
    )


def test_scenes_are_volumes_times_suns_with_names_that_tell_them_apart() -> None:
    volumes = [Path("a.vol"), Path("b.npz")]
    scenes = list_scenes(SceneChoice(camera_width=9), volumes, ["220,40", "90,20"])
    assert [name for name, _ in scenes] == ["a-sun220_40", "a-sun90_20", "b-sun220_40", "b-sun90_20"]
    assert (scenes[3][1].volume, scenes[3][1].sun_azimuth, scenes[3][1].sun_elevation) == (volumes[1], 90.0, 20.0)
    assert scenes[0][1].camera_width == 9
    assert [name for name, _ in list_scenes(SceneChoice(), [], [])] == [""]


@pytest.mark.parametrize("text", ["220", "220,40,1", "south,40", "0,91"])
def test_a_sun_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="sun"):
        parse_sun(text)


def test_problems_are_photographs_and_composed_ones_in_every_scene(tmp_path: Path) -> None:
    write_volume(tmp_path / "v.npz", build_cumulus(12))
    photograph = write_photograph(tmp_path / "x.png")
    scenes = list_scenes(SceneChoice(camera_width=16, camera_height=12), [tmp_path / "v.npz"], ["220,40", "90,20"])
    found = list_problems([photograph], None, scenes, 2, FitOptions(), tmp_path / "tables")
    assert [source.name for source in found] == [
        *("x-sun220_40", "synthetic_00-sun220_40", "synthetic_01-sun220_40"),
        *("x-sun90_20", "synthetic_00-sun90_20", "synthetic_01-sun90_20"),
    ]
    assert len({source.fingerprint() for source in found}) == 6
    with pytest.raises(InputError, match="nothing to compare on"):
        list_problems([], None, scenes, 0, FitOptions(), tmp_path)


def test_without_names_all_methods_are_compared() -> None:
    assert choose_methods(None) == dict(OPTIMISERS)
    assert list(choose_methods(["sbplx", "genetic"])) == ["sbplx", "genetic"]
    with pytest.raises(ParameterError, match="sbplx"):
        choose_methods(["unheard_of"])


def test_the_ranking_is_printed_or_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    comparison = compare_bowls(tmp_path, "one", "two")
    assert tell_comparison(comparison, Speaker(), as_json=False) == ALL_DONE
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:2] == ["method", "area"]
    assert lines[1].split()[0] == "genetic"
    assert lines[-1] == f"page: {tmp_path / 'index.html'}"
    assert tell_comparison(comparison, Speaker(), as_json=True) == ALL_DONE
    document = json.loads(capsys.readouterr().out)
    assert document["ranking_by_evaluations"] == ["genetic"]
    assert document["refused"] == {}


def test_failures_refusals_and_interruptions_have_their_exit_codes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done = compare_bowls(tmp_path, "one")
    refused = Comparison(done.report, {"two": "no cloud"}, done.analysis, done.page, done.document)
    assert tell_comparison(refused, Speaker(), as_json=False) == SOME_FAILED
    assert "two is left out: no cloud" in capsys.readouterr().err
    failing = ExperimentReport((make_run(failed=True),), 0, 1, False)
    assert tell_comparison(Comparison(failing, {}, None, done.page, done.document), Speaker(), False) == SOME_FAILED
    choosy = ExperimentReport(
        (replace(make_run("adam", failed=True), refused=True, message="no gradient"),), 0, 1, False
    )
    capsys.readouterr()
    assert tell_comparison(Comparison(choosy, {}, None, done.page, done.document), Speaker(), False) == ALL_DONE
    assert "adam is left out: no gradient" in capsys.readouterr().err
    stopped = Comparison(ExperimentReport((make_run(),), 0, 3, True), {})
    assert tell_comparison(stopped, Speaker(), as_json=False) == INTERRUPTED
    assert "after 1 of 3 runs; run the same command again" in capsys.readouterr().err


def test_the_watcher_says_what_is_kept_and_what_failed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    compare_bowls(tmp_path, "one", speaker=Speaker())
    assert "comparing 1 method on 1 problem from 2 seeds: 2 runs" in capsys.readouterr().err
    compare_bowls(tmp_path, "one", speaker=Speaker())
    assert "2 of 2 runs have been done before" in capsys.readouterr().err
    speaker = Speaker()
    with speaker.progress(1, "runs") as bars:
        Watcher(speaker, bars).finished(make_run("m", "p", failed=True))
    assert "m on p, seed 0" in capsys.readouterr().err


def test_the_defaults_of_the_options_are_those_of_the_library() -> None:
    defaults = inspect.signature(compare).parameters
    assert (defaults["seeds"].default, defaults["max_evaluations"].default) == (SEEDS, EVALUATIONS)
    assert SEEDS >= 15
