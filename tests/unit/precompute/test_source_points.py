"""Paths over points, and the source at points against quadrature and between seeds."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from precompute import source_points
from precompute.gather import Lattice
from precompute.order_plan import plan_orders
from precompute.path_sampler import TableNodes
from precompute.source_points import (
    LARGEST_BATCH,
    SMALLEST_BATCH,
    SourcePoints,
    SourceTable,
    allocate_paths,
)
from render.density_grid import DensityGrid
from render.fused import torch_loops_only
from tests.support.quadrature import box_source
from tests.support.statistics import passes_z_test
from tests.support.volumes import noise_box, uniform_box, view_north

pytestmark = pytest.mark.usefixtures("loops")

SUN = torch.tensor([0.6, -0.48, 0.64])
HALF = np.array([2.0, 2.5, 3.0])
POSITIONS = [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0]]
LATTICE = Lattice(torch.zeros(3), torch.tensor([1.5, 2.0, 1.0]), (2, 2, 1))
NODES = TableNodes(*(torch.tensor(v) for v in ([-0.3, 0.5], [0.2, 1.0], [-0.3, 0.5], [0.2, 1.0])))


def trace(paths: int = 64, seed: int = 0, orders: int = 2, points: int = 4, **changes: object) -> SourceTable:
    table = empty_table(seed, orders, changes.pop("grid", uniform_box()))  # type: ignore[arg-type]
    table.add_pass(SourcePoints(torch.arange(points), torch.full((points,), paths)), **changes)  # type: ignore[arg-type]
    return table


def empty_table(seed: int = 0, orders: int = 2, grid: DensityGrid | None = None) -> SourceTable:
    return SourceTable(grid or uniform_box(), view_north(), SUN, LATTICE, NODES, plan_orders(orders), 0.5, seed)


def test_paths_go_by_the_root_of_the_importance() -> None:
    importance = torch.tensor([1.0, 0.0, 16.0, 64.0, 0.0, 256.0], dtype=torch.float64)
    points = allocate_paths(importance.repeat(100), 100 * (8 + 32 + 64 + 128))
    assert points.numbers[:5].tolist() == [0, 2, 3, 5, 6]
    assert points.paths[:4].tolist() == [8, 32, 64, 128]
    assert len(points.numbers) == len(points.paths) == 400


@pytest.mark.parametrize("wanted", [20_000, 40_000, 100_000])
def test_the_number_of_paths_is_about_that_wanted(wanted: int) -> None:
    importance = torch.rand(1000, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    paths = allocate_paths(importance, wanted).paths
    assert wanted / 1.5 < int(paths.sum()) < wanted * 1.5
    assert torch.equal(paths.log2(), paths.log2().round())


def test_every_point_gets_its_least_and_none_more_than_the_most() -> None:
    importance = torch.tensor([1e-30, 1.0], dtype=torch.float64)
    assert allocate_paths(importance, 1).paths.tolist() == [SMALLEST_BATCH, SMALLEST_BATCH]
    assert allocate_paths(importance, 10**9).paths.tolist() == [LARGEST_BATCH, LARGEST_BATCH]
    assert len(allocate_paths(torch.zeros(5), 100).numbers) == 0


def repeated(seeds: int = 24) -> torch.Tensor:
    """Mean of both halves from many seeds `(seed, extinction, point, asymmetry)` at order two."""
    return torch.stack([trace(256, seed).source.mean(2)[:, :, 0] for seed in range(seeds)]).double()


def test_the_source_is_that_of_a_quadrature() -> None:
    runs = repeated()[:, :, : len(POSITIONS)]
    mean, variance = runs.mean(0), runs.var(0) / len(runs)
    exact, swapped = torch.empty_like(mean), torch.empty_like(mean)
    for number, position in enumerate(POSITIONS):
        for column, s in enumerate(NODES.extinction.tolist()):
            for row, g in enumerate(NODES.asymmetry.tolist()):
                arguments = (np.array(position), np.array([0.0, 1.0, 0.0]), SUN.double().numpy(), HALF, s)
                exact[column, number, row] = box_source(*arguments, g)
                swapped[column, number, row] = box_source(*arguments, -g)
    # A variance from 24 runs: Student's t, not the normal distribution; 8 numbers at 1e-3 allow 4.8.
    assert float(((mean - exact) / variance.sqrt()).abs().max()) < 4.8
    assert float(((mean - swapped) / variance.sqrt()).abs().max()) > 10.0


def test_halves_are_independent_and_agree() -> None:
    halves = torch.stack([trace(64, seed, orders=3).source for seed in range(40)]).double()
    first, second = halves.unbind(3)
    difference = (first - second).mean(0)
    variance = (first - second).var(0) / 40.0
    assert float((difference / variance.sqrt()).abs().max()) < 5.0
    assert not torch.equal(first, second)
    together = ((first - first.mean(0)) * (second - second.mean(0))).mean(0) / (first.std(0) * second.std(0))
    assert float(together.abs().max()) < 5.0 / math.sqrt(40.0)


def test_more_paths_less_noise_same_mean() -> None:
    few, many = (torch.stack([trace(n, seed).source.mean(2) for seed in range(30)]).double() for n in (16, 256))
    ratio = (few.var(0) / many.var(0)).mean()
    assert 10.0 < float(ratio) < 26.0
    assert passes_z_test(few.mean(0) - many.mean(0), (few.var(0) + many.var(0)) / 30.0, 1e-4)


def test_a_seed_gives_one_table_and_another_seed_another() -> None:
    first, again, other = trace(seed=1), trace(seed=1), trace(seed=2)
    assert torch.equal(first.source, again.source)
    assert torch.equal(first.effective_share, again.effective_share)
    assert not torch.equal(first.source, other.source)
    assert first.source.shape == (2, 4, 2, 1, 2)
    assert first.paths.tolist() == 4 * [64]


def test_the_effective_share_is_a_share() -> None:
    share = trace(grid=noise_box(), orders=4).effective_share
    assert share.shape == (3, 2, 2)
    assert (share > 0.0).all()
    assert (share <= 1.0).all()
    assert (share[0] > share[-1]).all()


def test_points_without_paths_give_an_empty_table() -> None:
    table = trace(points=0)
    assert table.source.shape == (2, 0, 2, 1, 2)
    assert len(table.paths) == 0


def test_passes_add_up_to_the_paths_of_one() -> None:
    """Path numbers go on from pass to pass, so halves of two passes are made of the quarters of one."""
    spread = SourcePoints(torch.arange(4), torch.full((4,), 64))
    twice, other = empty_table(seed=1), empty_table(seed=1)
    for _ in range(2):
        twice.add_pass(spread)
    once = trace(128, seed=1)
    torch.testing.assert_close(twice.source.mean(2), once.source.mean(2))
    torch.testing.assert_close(twice.effective_share, once.effective_share, rtol=0.05, atol=0.0)
    assert twice.paths.tolist() == once.paths.tolist()
    assert torch.equal(twice.numbers, once.numbers)
    other.add_pass(spread)
    assert not torch.allclose(other.source.mean(2), once.source.mean(2))


def test_passes_weigh_by_their_paths() -> None:
    """The second pass of 192 paths counts three times as much as the first of 64."""
    table = empty_table(seed=1)
    table.add_pass(SourcePoints(torch.arange(4), torch.full((4,), 64)))
    first = table.source.clone()
    for _ in range(3):
        table.add_pass(SourcePoints(torch.arange(4), torch.full((4,), 64)))
    whole = trace(256, seed=1)
    torch.testing.assert_close(table.source.mean(2), whole.source.mean(2))
    assert not torch.allclose(first.mean(2), whole.source.mean(2), rtol=1e-3)


def test_a_point_does_not_depend_on_those_beside_it() -> None:
    alone = empty_table(seed=1)
    alone.add_pass(SourcePoints(torch.tensor([2]), torch.tensor([64])))
    torch.testing.assert_close(alone.source[:, 0], trace(seed=1).source[:, 2])
    assert not torch.allclose(alone.source[:, 0], trace(seed=1).source[:, 1])


@pytest.mark.parametrize("lanes", [1, 100, 1 << 20])
def test_batches_are_no_part_of_the_result(lanes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = trace(orders=6)
    monkeypatch.setattr(source_points, "LANES", lanes)
    for found in (trace(orders=6), traced_by_torch(orders=6)):
        torch.testing.assert_close(found.source, expected.source, rtol=1e-5, atol=1e-8)
        torch.testing.assert_close(found.effective_share, expected.effective_share, rtol=1e-5, atol=0.0)


def traced_by_torch(**arguments: int) -> SourceTable:
    with torch_loops_only():
        return trace(**arguments)


def test_the_orders_of_a_shared_image_sum_to_it() -> None:
    """At albedo one all images together hold the orders two to seven, however they are shared out."""
    plan = plan_orders(7)
    assert plan.knots == (2, 3, 4, 6, 7)
    shared = torch.stack([trace(256, seed, 7).source.mean(2).sum(2) for seed in range(20)]).double()
    separate = torch.stack([separate_orders(256, seed, 7) for seed in range(100, 120)]).double()
    variance = (shared.var(0) + separate.var(0)) / 20.0
    assert passes_z_test(shared.mean(0) - separate.mean(0), variance, 1e-4)
    assert not passes_z_test(shared.mean(0) - 0.8 * separate.mean(0), variance, 1e-4)


def separate_orders(paths: int, seed: int, orders: int) -> torch.Tensor:
    """Sum of the orders `(extinction, point, asymmetry)` with an image for each of them."""
    table = empty_table(seed, orders)
    shares = torch.eye(orders - 1, dtype=torch.float64)
    knots = tuple(range(2, orders + 1))
    plan = dataclasses.replace(table.plan, knots=knots, shares=shares)
    apart = SourceTable(table.grid, table.camera, SUN, LATTICE, NODES, plan, 0.5, seed)
    apart.add_pass(SourcePoints(torch.arange(4), torch.full((4,), paths)))
    return apart.source.mean(2).sum(2)


def test_progress_rises_to_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_points, "LANES", 64)
    shares: list[float] = []
    trace(on_progress=shares.append)
    assert shares == [0.25, 0.5, 0.75, 1.0]
