"""What an effort allows, what follows a pass, and whether estimated errors are the true ones."""

import dataclasses
import math
from functools import cache

import pytest
import torch

from precompute.error_budget import (
    ALBEDOS,
    FIRST_SHARE,
    LEAST_GROWTH,
    MET_SHARE,
    MOST_GROWTH,
    PROBE_RAYS,
    Effort,
    ErrorProbe,
    NodeErrors,
    StopReason,
    box_error,
    choose_levels,
    next_pass,
    probe_rays,
)
from precompute.gather import lattice_over, stratify_rays
from precompute.order_plan import plan_orders
from precompute.path_sampler import TableNodes
from precompute.single_scattering import compute_single_scattering
from precompute.smoothing import find_neighbours
from precompute.source_points import SourcePoints, SourceTable
from precompute.view import view_of
from render.errors import ParameterError
from render.phase_functions import evaluate_phase_function
from tests.support.volumes import smooth_box, towards, view_north

EFFORT = Effort(orders=10, points=1000, paths=1_000_000, tolerance=0.05)


@pytest.mark.parametrize(
    "changes",
    [
        {"orders": 1},
        {"points": 0},
        {"paths": 0},
        {"strata": 0},
        {"tolerance": 0.0},
        {"tolerance": -0.1},
        {"tolerance": math.nan},
        {"max_seconds": 0.0},
        {"max_seconds": math.nan},
    ],
)
def test_efforts_outside_their_domain_are_refused(changes: dict[str, float]) -> None:
    with pytest.raises(ParameterError, match=r"at least|positive"):
        dataclasses.replace(EFFORT, **changes)  # type: ignore[arg-type]


def test_the_first_pass_is_all_or_a_part() -> None:
    assert dataclasses.replace(EFFORT, tolerance=None).first_paths == 1_000_000
    assert EFFORT.first_paths == round(FIRST_SHARE * 1_000_000)
    assert dataclasses.replace(EFFORT, points=100_000).first_paths == 400_000
    assert dataclasses.replace(EFFORT, points=10**7).first_paths == 1_000_000


def following(
    done: int = 100_000, error: float = 0.1, seconds: float = 1.0, seconds_a_path: float = 1e-5, **changes: float
) -> int | StopReason:
    effort = dataclasses.replace(EFFORT, **changes)  # type: ignore[arg-type]
    return next_pass(effort, done, error, seconds, seconds_a_path)


def test_without_a_tolerance_one_pass_is_all() -> None:
    assert next_pass(dataclasses.replace(EFFORT, tolerance=None), 10, 9.0, 0.0, 1.0) is StopReason.FIXED


def test_the_tolerance_ends_it() -> None:
    assert following(error=0.05) is StopReason.TOLERANCE
    assert following(error=0.0) is StopReason.TOLERANCE
    assert following(error=0.0501) is not StopReason.TOLERANCE
    assert following(done=10_000_000, error=0.05, seconds=1e9, max_seconds=1.0) is StopReason.TOLERANCE


def test_as_many_paths_follow_as_the_noise_needs() -> None:
    """Twice the tolerance needs four times the paths: three times as many again."""
    assert following(error=0.1) == 300_000
    assert following(error=0.0501) == round(LEAST_GROWTH * 100_000)
    assert following(done=10_000, error=5.0) == round(MOST_GROWTH * 10_000)


def test_the_paths_may_be_spent() -> None:
    assert following(done=800_000) is StopReason.PATHS
    assert following(done=1_000_001) is StopReason.PATHS
    assert following(done=600_000) == 400_000


def test_the_time_may_be_up() -> None:
    assert following(max_seconds=100.0) == 300_000
    assert following(max_seconds=3.0) == pytest.approx(200_000, abs=1)
    assert following(max_seconds=1.4) is StopReason.SECONDS
    assert following(seconds=5.0, max_seconds=3.0) is StopReason.SECONDS


def test_every_reason_is_a_sentence_of_its_own() -> None:
    assert len({reason.value for reason in StopReason}) == len(StopReason) == 5


def test_rays_of_a_probe_are_spread_evenly() -> None:
    assert torch.equal(probe_rays(7), torch.arange(7))
    assert torch.equal(probe_rays(PROBE_RAYS), torch.arange(PROBE_RAYS))
    for count in (PROBE_RAYS + 1, 10 * PROBE_RAYS, 1_000_003):
        rays = probe_rays(count)
        assert len(rays) == len(rays.unique()) == PROBE_RAYS
        assert (int(rays[0]), int(rays[-1])) == (0, count - 1)
        assert int(rays.diff().max()) <= count // (PROBE_RAYS - 1) + 1
    assert len(probe_rays(0)) == 0


def test_eleven_of_twelve_do_not_exceed_the_error_of_a_box() -> None:
    errors = torch.rand(5, 7, 100, generator=torch.Generator().manual_seed(0))
    assert float((errors <= box_error(errors)).double().mean()) == pytest.approx(MET_SHARE, abs=1e-3)
    worst = torch.zeros(12)
    worst[-1] = 9.0
    assert box_error(torch.cat([worst, torch.zeros(1)])) == 0.0
    assert box_error(torch.full((24,), 0.3)) == pytest.approx(0.3)
    assert box_error(torch.empty(0, 4)) == 0.0


def test_each_image_takes_its_own_level() -> None:
    levels = [torch.full((4, 2, 3, 2), float(number)) for number in range(4)]
    best = torch.tensor([[0, 1], [2, 3], [1, 0]])
    chosen = choose_levels(levels, best)
    assert torch.equal(chosen, best.float().expand(4, 2, 3, 2))
    assert torch.equal(choose_levels(levels[:1], torch.zeros(3, 2)), levels[0])


GRID, CAMERA, SUN = smooth_box(8, 12.0), view_north(16, 12, 18.0), towards(120.0, 30.0)
ASYMMETRY, EXTINCTION = torch.tensor([0.0, 0.6, 0.85]), torch.tensor([0.05, 0.5, 2.0])
PLAN = plan_orders(6)
SEEDS = 12


@cache
def images(paths: int, smooth: bool) -> tuple[list[list[NodeErrors]], torch.Tensor]:
    """Errors by seed and extinction, and composed images `(seed, extinction, albedo, asymmetry, ray)`."""
    view = view_of(GRID, CAMERA, SUN)
    lattice = lattice_over(GRID, 1.0)
    strata = stratify_rays(GRID, view.origin, view.direction, EXTINCTION, 8)
    single = compute_single_scattering(GRID, view.origin, view.direction, view.sun, EXTINCTION, 0.5, 16)
    numbers, albedo = torch.arange(lattice.size), torch.tensor(ALBEDOS)
    entry, knots = torch.arange(lattice.size, dtype=torch.int32), torch.tensor(PLAN.knots)
    probe = ErrorProbe(view, lattice, entry, strata, single, ASYMMETRY, knots, albedo)
    phase = evaluate_phase_function(view.direction @ view.sun, ASYMMETRY[:, None])
    lit = albedo[:, None, None] * phase * single[:, None, None]
    errors, composed = [], []
    for seed in range(SEEDS):
        nodes = TableNodes(ASYMMETRY, EXTINCTION, ASYMMETRY, EXTINCTION)
        table = SourceTable(GRID, CAMERA, view.sun, lattice, nodes, PLAN, 0.5, seed)
        table.add_pass(SourcePoints(numbers, torch.full_like(numbers, paths)))
        neighbours = find_neighbours(lattice, numbers, table.paths)
        measured, pictures = [], []
        for node, source in enumerate(table.source):
            levels = list(neighbours.levels(source.flatten(1)))[: None if smooth else 1]
            measured.append(probe.measure(node, levels))
            chosen = choose_levels([probe.gather(node, level) for level in levels], measured[-1].level)
            multiple = torch.einsum("ak,rkg->agr", albedo[:, None] ** knots, chosen.mean(1))
            pictures.append(lit[node] + multiple)
        errors.append(measured)
        composed.append(torch.stack(pictures))
    return errors, torch.stack(composed).double()


def estimated(paths: int, smooth: bool) -> torch.Tensor:
    """Root of the mean squared estimate over seeds `(extinction, albedo, asymmetry)`."""
    errors, _ = images(paths, smooth)
    return torch.stack([torch.stack([one.of_image for one in nodes]) for nodes in errors]).square().mean(0).sqrt()


def true_error(paths: int, smooth: bool, truth: torch.Tensor) -> torch.Tensor:
    found = images(paths, smooth)[1]
    return ((found - truth).square().mean((0, -1)) / truth.square().mean(-1)).sqrt()


def test_errors_without_smoothing_are_those_between_seeds() -> None:
    found = images(16, False)[1]
    # The mean of the seeds is the truth but for its own noise.
    real = true_error(16, False, found.mean(0)) * math.sqrt(SEEDS / (SEEDS - 1))
    ratio = estimated(16, False) / real
    assert 0.85 < float(ratio.log().mean().exp()) < 1.15
    assert 0.7 < float(ratio.min()) < float(ratio.max()) < 1.4
    assert all((one.level == 0).all() for nodes in images(16, False)[0] for one in nodes)


def test_errors_with_smoothing_count_its_bias() -> None:
    truth = images(256, False)[1].mean(0)
    real, found = true_error(16, True, truth), estimated(16, True)
    ratio = found / real
    assert 0.75 < float(ratio.log().mean().exp()) < 1.2
    assert 0.5 < float(ratio.min()) < float(ratio.max()) < 1.6
    assert float((real / true_error(16, False, truth)).log().mean().exp()) < 0.8
    assert any((one.level > 0).any() for nodes in images(16, True)[0] for one in nodes)


def test_errors_fall_with_the_root_of_the_paths() -> None:
    ratio = estimated(16, False) / estimated(256, False)
    assert 3.2 < float(ratio.log().mean().exp()) < 4.8


def test_errors_of_single_images_have_their_shape() -> None:
    one = images(16, True)[0][0][1]
    assert one.level.shape == one.of_knots.shape == (len(PLAN.knots), 3)
    assert one.of_image.shape == (len(ALBEDOS), 3)
    assert (one.of_knots > 0.0).all()
    assert (one.of_image < one.of_knots.amax(0)).all()
