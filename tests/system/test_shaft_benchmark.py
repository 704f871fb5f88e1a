"""The benchmark of shafts runs part by part in its quick version, and its measures are what they say."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from benchmarks.__main__ import main
from benchmarks.shaft_growth import fit_line
from benchmarks.shaft_measures import compute_reference, judge
from benchmarks.shaft_methods import fill_time, with_steps
from benchmarks.shafts import PARTS
from render.shafts.methods import METHODS, BruteForce
from tests.support.shaft_scenes import small_scene, small_stage


@pytest.fixture(autouse=True)
def _same_threads() -> Iterator[None]:
    """Benchmarks set the number of threads of their process; put it back."""
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def test_every_part_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "result.json"
    more = ["--threads", "1", "--scenes", "window", "--json", str(file), "--out", str(tmp_path)]
    assert main(["shafts", "--quick", *more]) == 0
    result = json.loads(file.read_text())
    assert set(PARTS) <= set(result)
    methods = result["methods"]["window"]["methods"]
    assert {"brute_force", "adaptive", "adaptive, refined", "chen2011", "engelhardt2010", "ali2017"} <= set(methods)
    for found in methods.values():
        assert 0.0 < found["relative_rms"] < 1.0
        assert found["seconds"]["median"] > 0.0
    assert methods["adaptive"]["ssim"] > methods["ali2017"]["ssim"]
    assert methods["brute_force"]["speed_up"] == 1.0
    assert {"depth buffer", "shadow maps", "marching"} <= set(result["stages"]["window"])
    assert [one["lamps"] for one in result["lamps"]["frames"]] == [1, 2, 4]
    triangles = result["triangles"]["frames"]
    assert triangles[0]["triangles"] < triangles[1]["triangles"]
    assert {one["depth"] for one in result["multiple"]} == {0.3, 1.0}
    assert all(one["shares"][1] > one["shares"][2] > 0.0 for one in result["multiple"])
    assert {"shafts_window.png", "shafts_window.svg"} <= {path.name for path in tmp_path.iterdir()}
    assert "as ambient light" in capsys.readouterr().out


def test_one_part_runs_alone(tmp_path: Path) -> None:
    file = tmp_path / "result.json"
    assert main(["shafts", "--quick", "--threads", "1", "--parts", "tolerance", "--json", str(file)]) == 0
    result = json.loads(file.read_text())
    assert not {"methods", "lamps"} & set(result)
    assert len(result["tolerance"]["scenes"]) == 2


def test_a_line_is_fitted_to_seconds() -> None:
    line = fit_line([1, 2, 4, 8], [3.0, 5.0, 9.0, 17.0])
    assert line["slope"] == pytest.approx(2.0)
    assert line["offset"] == pytest.approx(1.0)
    assert line["residual"] < 1e-9
    assert fit_line([1, 2, 4, 8], [1.0, 4.0, 16.0, 64.0])["residual"] > 0.1


def test_tiles_stand_for_a_large_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = small_stage(small_scene(120, 88))
    whole = compute_reference(stage, 1e-3)
    assert whole.shape == (1, 88, 120)
    monkeypatch.setattr("benchmarks.shaft_measures.MOST_LAMP_RAYS", 1)
    tiles = compute_reference(stage, 1e-3)
    assert tiles.shape == (64, 11, 11)
    assert len(tiles.pixels.unique()) == len(tiles.pixels)
    torch.testing.assert_close(tiles.light, whole.light[tiles.pixels], rtol=0.01, atol=1e-3)
    light = BruteForce(16).gather(stage).in_scattering
    assert judge(light, tiles)["relative_rms"] == pytest.approx(judge(light, whole)["relative_rms"], rel=0.3)
    assert judge(whole.light, whole) == {"relative_rms": 0.0, "largest": 0.0, "ssim": pytest.approx(1.0)}
    assert judge(light.flip(0), whole)["ssim"] < judge(light, whole)["ssim"] - 0.05


def test_steps_fill_a_time() -> None:
    assert with_steps(METHODS["chen2011"], 7).nodes == 7
    assert with_steps(METHODS["adaptive"], 7).steps == 7
    assert with_steps(METHODS["adaptive"], 7).lamp_steps == 7
    stage = small_stage(small_scene(64, 48, lamps=False))
    reference = compute_reference(stage, 1e-2)
    few, many = (fill_time(BruteForce(64), stage, reference, budget) for budget in (1e-9, 1.0))
    assert few["steps"] == 1
    assert many["steps"] > 64
    assert many["relative_rms"] < few["relative_rms"]
