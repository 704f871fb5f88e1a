"""Every benchmark runs in its quick version, prints its answer and writes the same as JSON."""

import json
import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from benchmarks.__main__ import BENCHMARKS, main
from benchmarks.common import harmonic_mean, peak_memory_mb, spread
from benchmarks.front import Point, pareto_front
from benchmarks.masks import compare
from benchmarks.mitsuba_peer import PeerCost
from benchmarks.parameter_sets import Disagreement, ParameterSet, table_nodes, varied
from benchmarks.stack_peers import nodes_by_depth
from benchmarks.synthetic_photograph import MIDDLE, draw_truth, photograph_by_path_tracing
from cloudfit.losses import LOSSES
from cloudfit.quality import QUALITIES
from cloudfit.scene import Scene
from precompute import smoothing
from render.camera import frame_volume
from render.depth_nodes import place_depths
from render.image_files import write_mask_png, write_png
from render.procedural_cloud import build_cumulus


@pytest.fixture(autouse=True)
def _same_threads() -> Iterator[None]:
    """Benchmarks set the number of threads of their process; put it back."""
    threads = torch.get_num_threads(), cv2.getNumThreads()
    yield
    torch.set_num_threads(threads[0])
    cv2.setNumThreads(threads[1])


def run_quick(name: str, folder: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[dict, str]:
    file = folder / "result.json"
    assert main([name, "--quick", "--json", str(file), *more]) == 0
    return json.loads(file.read_text()), capsys.readouterr().out


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_benchmark_asks_one_question(name: str) -> None:
    assert BENCHMARKS[name].question.endswith("?")


def test_the_cost_of_a_stack_stands_beside_its_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result, out = run_quick("stack_cost", tmp_path, capsys, "--threads", "1")
    measures = result["measures"]
    assert result["machine"]["threads"] == 1
    assert result["machine"]["versions"]["torch"]
    assert measures["build_seconds"]["median"] > 0.0
    assert 0.0 < measures["image_error_median"]["median"] <= measures["image_error_worst"]["median"] < 1.0
    assert measures["memory_after_imports_mb"]["median"] <= measures["peak_memory_of_build_mb"]["median"]
    assert "iteration_ms" in out
    assert min(measures[name]["median"] for name in ("iteration_ms", "refined_iteration_ms")) > 0.0


def test_fog_is_timed_and_judged_beside_the_march(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result, out = run_quick("fog", tmp_path, capsys, "--threads", "1")
    for medium in ("uniform", "linear", "exponential"):
        row = result["media"][medium]
        assert row["closed_form_error_float64"]["largest"] < 1e-9
        assert row["closed_form_error"]["percentile"] < 1e-5
        errors = [row["march_errors"][steps]["percentile"] for steps in ("4", "16", "64")]
        assert errors[0] > errors[1] > errors[2] > 1e-4
        assert 0.0 < row["round_ground_difference"]["median"] < 1e-2
        assert row["nanoseconds_per_ray"]["closed form"]["count"] == 2
    assert "not reached" in out


def test_evaluations_are_timed_beside_a_scalar_loop_in_the_same_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result, out = run_quick("evaluation", tmp_path, capsys, "--threads", "1")
    counting = result["counting_ms"]
    assert {"cloudfit", "torch, scatter_add", "torch, bincount"} <= set(counting)
    if "ratio" in counting:
        ours, theirs = counting["cloudfit"], counting["scalar loop"]
        assert (
            ours["smallest"] / theirs["largest"] <= counting["ratio"]["median"] <= ours["largest"] / theirs["smallest"]
        )
    assert set(result["losses_ms"]) == set(LOSSES)
    assert {name for name, ways in result["losses_ms"].items() if "starts_with_gradient" in ways} == {
        name for name, loss in LOSSES.items() if loss.is_differentiable
    }
    assert all(result["coarse_air"][f"refined {number} times"]["excess_mean"] >= -0.5 for number in (0, 2))
    assert result["coarse_air"]["refined 0 times"]["excess_largest"] >= 0.0
    four = result["populations"]["4"]
    assert four["ms"]["median"] > 0.0
    assert four["peak_mb"] >= four["held_mb"] > 20.0
    assert "cloudfit over scalar loop" in out or "ratio" not in counting


def test_every_knob_of_a_stack_has_its_time_and_its_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result, out = run_quick("tradeoff", tmp_path, capsys, "--threads", "1", "--out", str(tmp_path))
    measured = {(one["knob"], one["value"]): one for one in result["measured"]}
    assert all(one["seconds"]["median"] > 0.0 < one["error"]["median"] for one in measured.values())
    assert {knob for knob, _ in measured} == {"preset", *result["settings"]["knobs"]}
    preset, rough = measured["preset", "as it is"], measured["smoothing", "none"]
    assert rough["error"]["median"] > 2.0 * preset["error"]["median"]
    assert measured["bins", "64"]["seconds"] == preset["seconds"]
    assert any(one["on_front"] for one in measured.values())
    assert "smoothing" in out
    assert (tmp_path / "tradeoff.png").stat().st_size > 0 < (tmp_path / "tradeoff.svg").stat().st_size


def test_the_growth_of_a_stack_is_shown_with_its_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result, out = run_quick("stack", tmp_path, capsys, "--threads", "1")
    builds = [build for row in result["growth"]["rows"] for build in row["builds"]]
    assert all(build["seconds"] > 0.0 < build["error"] and build["peak_mb"] >= build["before_mb"] for build in builds)
    if "skipped" not in result["loops"]:
        assert result["loops"]["torch"]["paths"] == result["loops"]["fused"]["paths"]
    assert "peers" in out
    if "skipped" not in result["peers"]:
        nodes = result["peers"]["charges"]["scalar_rgb"]
        total = sum(node["nodes"] * node["at_stack_error"] for node in nodes)
        assert result["peers"]["totals"]["scalar_rgb"]["at_stack_error_seconds"] == pytest.approx(total)


def test_every_node_of_a_table_is_charged_once_and_noise_falls_with_the_root_of_the_work() -> None:
    charged = nodes_by_depth(place_depths(0.05, 60.0, 11), 7)
    assert sum(charged) == 77
    assert charged[1] > charged[0] > 0  # two of the depths are thin
    assert charged[2] > 0
    peer = PeerCost("scalar_rgb", ParameterSet(0.0, 6.0, 1.0), 16, 9.0, 2.0, 0.1)
    assert peer.seconds_for(0.1) == pytest.approx(2.0)
    assert peer.seconds_for(0.01) == pytest.approx(200.0)


def test_the_front_holds_what_nothing_beats() -> None:
    points = [Point("a", "", seconds, error) for seconds, error in ((1.0, 3.0), (2.0, 4.0), (3.0, 1.0), (3.0, 2.0))]
    assert pareto_front(points) == [0, 2]


def test_varied_constants_are_put_back() -> None:
    before = smoothing.LEVELS
    with varied(((smoothing, "LEVELS", before + 1),)):
        assert before + 1 == smoothing.LEVELS
    assert before == smoothing.LEVELS


@pytest.mark.slow
def test_known_parameters_are_reported_beside_those_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result, out = run_quick("recovery", tmp_path, capsys)
    assert len(result["fits"]) == 8  # two photographs and two noisier versions of the first, two seeds each
    assert result["summary"]["loss / floor"]["count"] == 4
    assert all(0.0 < fit["floor"] < fit["flat_floor"] for fit in result["fits"])
    noise = [photograph["noise"] for photograph in result["photographs"]]
    assert noise[2] > noise[3] > noise[0] > 0.0
    assert "loss / floor" in out


@pytest.mark.slow
def test_fits_of_a_folder_are_listed_with_their_memory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result, out = run_quick("photographs", tmp_path, capsys, "--threads", "1")
    (photograph,) = result["photographs"]
    assert photograph["status"] == "done", photograph["reason"]
    assert photograph["peak_memory_mb"] > 50.0
    assert "cumulus.png" in out


@pytest.mark.parametrize("at", ["random", "nodes"])
def test_errors_of_stacks_are_compared_with_what_they_state(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], at: str
) -> None:
    result, out = run_quick("accuracy", tmp_path, capsys, "--threads", "1", "--at", at, "--out", str(tmp_path))
    (case,) = result["cases"]
    assert "accepted" in out
    assert case["stated_well"] <= case["known"] <= len(case["sets"]) == 2
    assert all(0.0 < one["estimated"] < 1.0 and one["reference_noise"] > 0.0 for one in case["sets"])
    asymmetry, _ = table_nodes(QUALITIES["draft"], 1.0)
    assert all((one["asymmetry"] in asymmetry.tolist()) == (at == "nodes") for one in case["sets"])


def test_an_error_is_known_where_it_stands_out_of_the_reference_s_noise() -> None:
    assert Disagreement(error=0.02, bias=0.0, noise=0.03, deviation=0.003).known
    assert not Disagreement(error=0.01, bias=0.0, noise=0.03, deviation=0.006).known
    assert not Disagreement(error=0.0, bias=0.0, noise=0.03, deviation=0.006).known


def test_masks_are_compared_with_labels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result, out = run_quick("masks", tmp_path, capsys)
    (photograph,) = result["photographs"]
    assert 0.9 < photograph["balanced_accuracy"] <= 1.0
    assert "balanced accuracy" in out


def test_agreement_with_labels_counts_every_label(tmp_path: Path) -> None:
    # A white disk on a blue sky, half of it labelled as cloud, and labels of sky on both.
    pixels = torch.tensor([0.1, 0.3, 0.7]).repeat(96, 128, 1)
    y, x = torch.meshgrid(torch.arange(96), torch.arange(128), indexing="ij")
    disk = (x - 64) ** 2 + (y - 48) ** 2 < 30**2
    pixels[disk] = 0.9
    write_png(tmp_path / "disk.png", pixels)
    labels = np.zeros((96, 128), np.uint8)
    labels[44:52, 50:64] = 255
    labels[5:15, 5:25] = 170
    write_mask_png(tmp_path / "disk_right.png", labels)
    right = compare(tmp_path / "disk.png", tmp_path / "disk_right.png")
    assert (right.cloud_met, right.sky_not_cloud, right.balanced_accuracy) == (1.0, 1.0, 1.0)
    assert right.other_as_cloud is None
    labels[44:52, 64:78] = 170  # as many labels of sky on the disk as a little more than half of those beside it
    write_mask_png(tmp_path / "disk_wrong.png", labels)
    wrong = compare(tmp_path / "disk.png", tmp_path / "disk_wrong.png")
    assert wrong.sky_not_cloud == pytest.approx(200 / (200 + 8 * 14))
    assert wrong.balanced_accuracy == pytest.approx(0.5 + 100 / (200 + 8 * 14))


def test_the_synthetic_photograph_has_the_brightness_and_the_noise_that_it_states(tmp_path: Path) -> None:
    grid = build_cumulus(16)
    scene = Scene(grid, None, frame_volume(grid, width=24, height=18), 2.0, 0.7)
    made = [
        photograph_by_path_tracing(
            scene, scene.camera, MIDDLE, tmp_path / f"{seed}.png", noise=0.1, most_samples=256, seed=seed
        )
        for seed in range(2)
    ]
    assert all(0.05 < photograph.noise < 0.15 for photograph in made)
    values = [photograph.read().pixels[photograph.cloud] for photograph in made]
    relative = (values[0] - values[1])[:, 1] / (0.5 * (values[0] + values[1]))[:, 1]
    measured = float(relative.abs().median()) / 0.6745 / math.sqrt(2.0)
    assert measured == pytest.approx(made[0].noise, rel=0.35)
    again = photograph_by_path_tracing(
        scene, scene.camera, MIDDLE, tmp_path / "0.png", noise=0.1, most_samples=256, seed=0
    )
    assert again.truth == made[0].truth
    assert again.noise == made[0].noise


def test_true_parameters_are_reproducible_and_in_their_ranges() -> None:
    truths = [draw_truth(torch.Generator().manual_seed(seed)) for seed in range(50)]
    assert truths[7].asymmetry == draw_truth(torch.Generator().manual_seed(7)).asymmetry
    assert all(2.0 <= truth.optical_depth <= 60.0 and 0.8 <= truth.albedo <= 1.0 for truth in truths)
    assert len({truth.asymmetry for truth in truths}) == 50


def test_median_and_quartiles() -> None:
    assert spread([4.0, 1.0, 3.0, 2.0, 5.0]) == {
        "median": 3.0,
        "lower_quartile": 2.0,
        "upper_quartile": 4.0,
        "smallest": 1.0,
        "largest": 5.0,
        "count": 5,
    }
    assert spread([2.0])["upper_quartile"] == 2.0
    with pytest.raises(ValueError, match="no measurements"):
        spread([])


def test_two_pixel_counts_make_one() -> None:
    assert harmonic_mean(100, 100) == 100
    assert harmonic_mean(1, 1_000_000) == 2


def test_memory_is_counted_in_mebibytes() -> None:
    block = np.ones(64 << 20, np.uint8)
    peak = peak_memory_mb()
    assert 64.0 < peak < 64_000.0
    assert block[-1] == 1
    assert peak_memory_mb() >= peak


def test_an_unknown_volume_is_an_error_with_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["recovery", "--volume", "no/such/volume.npz"]) == 3
    assert "no/such/volume.npz" in capsys.readouterr().err
