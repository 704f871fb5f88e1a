import os
from pathlib import Path

from cloudfit.batch import BatchSettings, fit_folder
from cloudfit.fit_types import FitOptions
from cloudfit.one_photograph import StackSource
from cloudfit.result import read_result
from cloudfit.scene_record import volume_hash
from cloudfit.worker_pool import _pack
from tests.support.fake_stages import FAKE_STAGES
from tests.support.hand_made_fit import small_scene, write_photograph


def test_a_scene_survives_the_way_to_a_worker() -> None:
    scene = small_scene()
    source = _pack(StackSource(scene, FitOptions(seed=3), Path("tables"), FAKE_STAGES), "token", 1).unpack()
    assert volume_hash(source.scene.grid) == volume_hash(scene.grid)
    assert (source.scene.camera, source.scene.sun_azimuth) == (scene.camera, scene.sun_azimuth)
    assert source.options.seed == 3


def test_workers_do_the_same_and_a_dying_one_takes_one_photograph_with_it(tmp_path: Path) -> None:
    files = [write_photograph(tmp_path / f"{name}.png") for name in ("a", "deadly", "surprise")]
    out = tmp_path / "out"
    settings = BatchSettings(out, jobs=2)
    report = fit_folder(files, small_scene(), FitOptions(), settings, stages=FAKE_STAGES)
    by_name = {outcome.job.photograph.stem: outcome for outcome in report.outcomes}
    statuses = {name: outcome.status for name, outcome in by_name.items()}
    assert statuses == {"a": "done", "deadly": "failed", "surprise": "failed"}
    assert "died" in str(by_name["deadly"].reason)
    assert "ZeroDivisionError" in str(by_name["surprise"].reason)
    assert read_result(out / "deadly")["status"] == "failed"
    assert {path.name for path in out.iterdir()} == {*statuses, ".tables", "index.html"}, "nothing half-written"
    lines = [line.split() for line in (tmp_path / "log.txt").read_text().splitlines()]
    assert str(os.getpid()) not in {process for _, process, _ in lines}
    assert {threads for _, _, threads in lines} == {str(max(1, len(os.sched_getaffinity(0)) // 2))}
    calls = (out / ".tables" / "calls.txt").read_text().splitlines()
    assert calls[0] == str(os.getpid()), "the stack is made here before any worker asks for it"
