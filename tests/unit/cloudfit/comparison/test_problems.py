import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from cloudfit.comparison.problems import ComposedSource, PhotographSource, SceneSource, Shelf, load_problem
from cloudfit.fit_types import FitOptions
from cloudfit.scene_record import describe_scene
from render.errors import PhotographError
from render.image_files import write_mask_png, write_png
from render.volume_files import write_volume
from tests.support.small_scene import TINY, ball, small_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SceneSource:
    folder = tmp_path_factory.mktemp("scene")
    write_volume(folder / "ball.npz", ball())
    record = describe_scene(replace(small_scene(), volume=folder / "ball.npz"))
    return SceneSource(record, FitOptions(quality=TINY), folder / "tables")


def test_a_composed_problem_knows_its_answer_and_draws_it(scene: SceneSource) -> None:
    problem = load_problem(ComposedSource("one", 3, scene))
    assert problem.truth is not None
    facts = problem.facts()
    assert facts["truth_loss"] == pytest.approx(problem.loss(problem.truth))
    assert facts["truth_loss"] < 1e-3 < facts["floor"]
    assert (facts["name"], facts["dimension"]) == ("one", 5)
    drawn, photograph = problem.picture(problem.truth), problem.fit.analysis.photograph.pixels
    assert drawn.shape == photograph.shape
    assert torch.allclose(drawn, photograph, atol=1e-4)
    other = problem.picture(torch.full((5,), 0.9))
    assert not torch.allclose(other, photograph, atol=1e-2)


def test_loaded_problems_and_stacks_are_kept(scene: SceneSource) -> None:
    first, again, other = (load_problem(ComposedSource("one", seed, scene)) for seed in (3, 3, 4))
    assert first is again
    assert other is not first
    assert other.fit.stack is first.fit.stack


def test_the_fingerprint_tells_what_a_run_depends_on(scene: SceneSource, tmp_path: Path) -> None:
    source = ComposedSource("one", 3, scene)
    brighter = replace(scene, options=FitOptions(quality=TINY, transfer="none"))
    elsewhere = replace(scene, tables=tmp_path)
    assert source.fingerprint() == ComposedSource("renamed", 3, elsewhere).fingerprint()
    assert source.fingerprint() != ComposedSource("one", 4, scene).fingerprint()
    assert source.fingerprint() != ComposedSource("one", 3, brighter).fingerprint()
    photograph = PhotographSource("p", tmp_path / "p.png", None, scene)
    write_png(tmp_path / "p.png", torch.full((8, 8, 3), 0.5))
    before = photograph.fingerprint()
    write_png(tmp_path / "p.png", torch.full((8, 8, 3), 0.6))
    assert photograph.fingerprint() != before


def test_a_photograph_is_read_and_analysed(scene: SceneSource, tmp_path: Path) -> None:
    composed = load_problem(ComposedSource("one", 3, scene))
    path = tmp_path / "p.png"
    write_png(path, composed.fit.analysis.photograph.pixels)
    write_mask_png(tmp_path / "mask.png", composed.fit.analysis.mask.cloud)
    truth = dict.fromkeys(composed.fit.space.names, 0.5)
    source = PhotographSource("p", path, tmp_path / "mask.png", scene, truth)
    problem = source.load()
    assert problem.truth is not None
    assert math.isfinite(problem.loss(problem.truth))
    with pytest.raises(PhotographError, match=r"gone\.png"):
        replace(source, photograph=tmp_path / "gone.png").load()


def test_a_shelf_keeps_what_was_asked_for_last() -> None:
    made = []

    def make(key: str) -> str:
        made.append(key)
        return key

    shelf: Shelf[str] = Shelf(2)
    for key in ("a", "b", "a", "c", "a", "b"):
        assert shelf.get(key, lambda key=key: make(key)) == key
    assert made == ["a", "b", "c", "b"]
