"""The fused path tracer is the one in torch, path by path: same random numbers, same weights, same sums."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import pytest
import torch

pytest.importorskip("numba")

from precompute import fused_paths, source_points
from precompute.carried_orders import last_traced_orders
from precompute.gather import lattice_over
from precompute.order_plan import plan_orders
from precompute.path_sampler import TableNodes, every_order
from precompute.source_points import SourcePoints, SourceTable
from render.density_grid import DensityGrid
from render.fused import fused_loops_wanted, torch_loops_only
from tests.support.volumes import noise_box, ramp_box, smooth_box, towards, uniform_box, view_north

pytestmark = pytest.mark.skipif(not fused_loops_wanted(), reason="the fused loops are turned off")

GRIDS: dict[str, Callable[[], DensityGrid]] = {
    "noise": noise_box,
    "holes": lambda: noise_box(8, sparse=0.7),
    "ramp": ramp_box,
    "waves": smooth_box,
    "one voxel": lambda: uniform_box(voxels=(1, 1, 1)),
    "one voxel thick": lambda: uniform_box(voxels=(5, 1, 7), density=0.3),
    "one column": lambda: DensityGrid.from_voxel_size(torch.linspace(0.0, 1.0, 9).reshape(9, 1, 1), (1.0, 2.0, 0.5)),
    "empty": lambda: DensityGrid.from_voxel_size(torch.zeros(3, 4, 5), 1.0),
}


@dataclass(frozen=True)
class Case:
    """What is traced."""

    grid: str = "noise"
    orders: int = 4
    asymmetry: tuple[float, ...] = (-0.3, 0.2, 0.6, 0.85)
    extinction: tuple[float, ...] = (0.1, 1.0, 8.0)
    anchors: tuple[float, ...] | None = None
    points: int = 6
    paths: int = 64
    seed: int = 1
    last_order: Callable[[torch.Tensor], torch.Tensor] = every_order


def trace(case: Case) -> SourceTable:
    grid = GRIDS[case.grid]()
    lattice = lattice_over(grid, 1.0)
    asymmetry, extinction = torch.tensor(case.asymmetry), torch.tensor(case.extinction)
    anchors = extinction if case.anchors is None else torch.tensor(case.anchors)
    nodes = TableNodes(asymmetry, extinction, asymmetry, anchors, case.last_order)
    numbers = torch.linspace(0, lattice.size - 1, min(case.points, lattice.size)).long()
    table = SourceTable(
        grid, view_north(), towards(50.0, 25.0), lattice, nodes, plan_orders(case.orders), 0.5, case.seed
    )
    table.add_pass(SourcePoints(numbers, torch.full_like(numbers, case.paths)))
    return table


def difference(case: Case, other: Case | None = None) -> float:
    """Largest difference of a mean or an effective share over the largest of its image and node."""
    fused = trace(case)
    with torch_loops_only():
        plain = trace(other or case)
    largest = plain.source.amax((1, 2), keepdim=True).clamp(min=1e-30)
    of_share = (fused.effective_share - plain.effective_share).abs().max()
    return max(float(((fused.source - plain.source) / largest).abs().max()), float(of_share))


@pytest.mark.parametrize("orders", [4, 18, 66])
@pytest.mark.parametrize("name", GRIDS)
def test_every_volume_gives_the_sums_of_torch(name: str, orders: int) -> None:
    assert difference(Case(name, orders)) < 6e-5


@pytest.mark.parametrize(
    "asymmetry", [(-0.99, 0.99), (-0.999, 0.0, 0.999), (0.0,), (0.99,), (0.6, 0.85, 0.95), (-0.99,)]
)
@pytest.mark.parametrize("orders", [4, 18])
def test_every_lobe_gives_the_sums_of_torch(asymmetry: tuple[float, ...], orders: int) -> None:
    # Cosines are rounded to 6e-8 on both sides; next to (1 - g)^2 that is a part of a peak's height, several times a path.
    width = 1.0 - max(abs(g) for g in asymmetry)
    assert difference(Case(orders=orders, asymmetry=asymmetry)) < 1e-5 + 10.0 * 6e-8 / width**2


@pytest.mark.parametrize(
    ("extinction", "accepted"),
    # A length of some metres is rounded to some 1e-7 m, which is 1e-4 of exponent for 500 per metre, adds up along a path, and decides
    # about sums that a single path lights.
    [((1e-6, 1e-3), 1e-6), ((0.5,), 2e-5), ((1e-6, 1.0, 2000.0), 5e-5), ((100.0,), 5e-5), ((100.0, 500.0), 4e-2)],
)
@pytest.mark.parametrize("orders", [4, 18])
def test_every_thickness_gives_the_sums_of_torch(extinction: tuple[float, ...], accepted: float, orders: int) -> None:
    assert difference(Case(orders=orders, extinction=extinction)) < accepted


@pytest.mark.parametrize("anchors", [(0.5,), (1.0, 4.0), (0.1, 1.0, 8.0, 20.0)])
def test_anchors_may_be_others_than_the_nodes(anchors: tuple[float, ...]) -> None:
    assert difference(Case(orders=10, anchors=anchors)) < 1e-4


def test_another_seed_or_thickness_gives_other_sums() -> None:
    assert difference(Case(), Case(seed=2)) > 1e-2
    assert difference(Case(), Case(extinction=(0.1, 1.0, 8.01))) > 1e-4
    assert difference(Case(), Case(asymmetry=(-0.3, 0.2, 0.6, 0.851))) > 1e-4


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(("chunk", "lanes"), [(1, 1), (2, 1 << 20), (1 << 20, 100)])
def test_threads_chunks_and_batches_are_no_part_of_the_result(
    threads: int, chunk: int, lanes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = trace(Case(orders=10, points=50))
    monkeypatch.setattr(fused_paths, "CHUNK", chunk)
    monkeypatch.setattr(source_points, "LANES", lanes)
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        found = trace(Case(orders=10, points=50))
    finally:
        torch.set_num_threads(before)
    torch.testing.assert_close(found.source, expected.source, rtol=1e-6, atol=0.0)
    torch.testing.assert_close(found.effective_share, expected.effective_share, rtol=1e-6, atol=0.0)


def test_the_sun_at_the_zenith_and_at_the_nadir() -> None:
    """The frame around a direction changes its sign where the third coordinate does."""
    for sun in (torch.tensor([0.0, 0.0, 1.0]), torch.tensor([0.0, 0.0, -1.0]), torch.tensor([0.0, 1.0, 0.0])):
        tables = []
        for only_torch in (False, True):
            grid = noise_box()
            nodes = TableNodes(*(torch.tensor(v) for v in ([0.0, 0.8], [1.0], [0.0, 0.8], [1.0])))
            table = SourceTable(grid, view_north(), sun, lattice_over(grid, 1.0), nodes, plan_orders(4), 0.5, 0)
            points = SourcePoints(torch.arange(20), torch.full((20,), 64))
            if only_torch:
                with torch_loops_only():
                    table.add_pass(points)
            else:
                table.add_pass(points)
            tables.append(table.source)
        torch.testing.assert_close(tables[0], tables[1], rtol=1e-4, atol=1e-6)


def short_for_round_lobes(asymmetry: torch.Tensor) -> torch.Tensor:
    return torch.where(asymmetry.abs() < 0.5, 3, 10)


@pytest.mark.parametrize("last_order", [short_for_round_lobes, partial(last_traced_orders, degree=3)])
@pytest.mark.parametrize("name", ["noise", "one voxel thick"])
def test_asymmetries_end_where_they_do_in_torch(name: str, last_order: Callable[[torch.Tensor], torch.Tensor]) -> None:
    case = Case(name, orders=18, last_order=last_order)
    assert difference(case) < 6e-5
    assert difference(case, Case(name, orders=18)) > 1e-2
    # Images of the knots beyond its last order are black for a node, and lit for others.
    table = trace(case)
    lit = (table.source > 0.0).any(0).any(0).any(0)
    last = last_order(torch.tensor(case.asymmetry))
    for below, of_knot in zip((0, *table.plan.knots), lit, strict=False):
        assert torch.equal(of_knot, last > below)
