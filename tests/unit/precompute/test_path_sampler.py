"""One set of paths for a whole table: every node agrees with paths drawn for it alone, and no weight explodes."""

import dataclasses
import math

import pytest
import torch

from precompute import path_sampler
from precompute.order_plan import OrderPlan, plan_orders
from precompute.path_sampler import FORWARD_EXPONENT, Draw, TableNodes, VertexWeights, sample_paths
from render.density_grid import DensityGrid
from render.phase_functions import evaluate_phase_function
from render.random_streams import counter_keys, stream_number
from tests.support.statistics import passes_z_test, z_scores
from tests.support.volumes import noise_box, scaled, towards, uniform_box

PLAN = plan_orders(4)
PATHS = 60_000
SUN = towards(50.0, 25.0)
AHEAD = torch.tensor([0.0, 1.0, 0.0])
ASYMMETRY = torch.tensor([-0.3, 0.2, 0.6, 0.85])
EXTINCTION = torch.tensor([0.1, 0.3, 1.0, 3.0])


def nodes_of(asymmetry: list[float] | None = None, extinction: list[float] | None = None) -> TableNodes:
    """The whole table with given anchors, all nodes by default."""
    return TableNodes(
        ASYMMETRY,
        EXTINCTION,
        ASYMMETRY if asymmetry is None else torch.tensor(asymmetry),
        EXTINCTION if extinction is None else torch.tensor(extinction),
    )


def draw(
    nodes: TableNodes,
    paths: int = PATHS,
    seed: int = 0,
    grid: DensityGrid | None = None,
    factor: float = 1.0,
    plan: OrderPlan = PLAN,
    first: int = 0,
) -> list[VertexWeights]:
    volume = grid or noise_box()
    start = torch.tensor([0.4, -1.0, 0.3]).expand(paths, 3) * factor
    keys = counter_keys(stream_number(seed), torch.arange(first, first + paths))
    return list(sample_paths(volume, start, AHEAD.expand(paths, 3), SUN, nodes, plan, 0.5, keys))


def moments(vertices: list[VertexWeights], paths: int = PATHS) -> tuple[torch.Tensor, torch.Tensor]:
    """Means of G S over all paths and their variances `(order, asymmetry, extinction)`."""
    orders = sorted({vertex.order for vertex in vertices})
    weights = torch.zeros(len(orders), paths, len(ASYMMETRY), len(EXTINCTION), dtype=torch.float64)
    for vertex in vertices:
        both = vertex.asymmetry_factor.double()[:, :, None] * vertex.extinction_factor.double()[:, None, :]
        weights[orders.index(vertex.order)].index_add_(0, vertex.path, both)
    return weights.mean(1), weights.var(1) / paths


def by_themselves(row: int, column: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and variance `(order,)` of one node from paths whose only anchor it is."""
    g, s = float(ASYMMETRY[row]), float(EXTINCTION[column])
    mean, variance = moments(draw(nodes_of([g], [s]), seed=1000 + 10 * row + column))
    return mean[:, row, column], variance[:, row, column]


def compare(nodes: TableNodes, pairs: list[tuple[int, int]], exponent: float = 1.0) -> bool:
    """Whether the nodes of shared paths have the means of their own paths; a wrong exponent of s spoils them."""
    means, variances = moments(draw(nodes))
    differences, spreads = [], []
    for row, column in pairs:
        mean, variance = by_themselves(row, column)
        shared = means[:, row, column] * EXTINCTION[column].double() ** (exponent - 1.0)
        differences.append(shared - mean)
        spreads.append(variances[:, row, column] + variance)
    return passes_z_test(torch.stack(differences), torch.stack(spreads))


def test_every_node_has_the_mean_of_its_own_paths() -> None:
    pairs = [(0, 0), (0, 3), (1, 1), (1, 2), (2, 0), (2, 3), (3, 1), (3, 2)]
    assert compare(nodes_of(), pairs)
    assert not compare(nodes_of(), pairs, exponent=1.2)


def test_nodes_between_the_anchors_have_it_too() -> None:
    anchors = nodes_of([-0.3, 0.85], [0.1, 3.0])
    pairs = [(1, 1), (1, 2), (2, 1), (2, 2)]
    assert compare(anchors, pairs)
    assert not compare(anchors, pairs, exponent=1.2)


@pytest.mark.parametrize("column", [0, 2])
def test_branches_change_noise_but_no_mean(column: int, monkeypatch: pytest.MonkeyPatch) -> None:
    mean, variance = moments(draw(nodes_of()))
    monkeypatch.setattr(path_sampler, "branch_probability", torch.zeros_like)
    plain, plain_variance = moments(draw(nodes_of(), seed=5))
    assert passes_z_test((mean - plain)[..., column], (variance + plain_variance)[..., column])
    assert float((variance[:, -1, column] / plain_variance[:, -1, column]).max()) < 0.9


def largest_factors(vertices: list[VertexWeights]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Largest G over the phase function's peak `(vertex, asymmetry)`, largest S `(vertex, extinction)`, and the orders."""
    peak = evaluate_phase_function(ASYMMETRY.sign(), ASYMMETRY)
    vertices = [v for v in vertices if len(v.path)]
    return (
        torch.stack([(v.asymmetry_factor / peak).amax(0) for v in vertices]),
        torch.stack([v.extinction_factor.amax(0) for v in vertices]),
        torch.tensor([v.order for v in vertices]),
    )


@pytest.mark.parametrize("factor", [0.1, 1.0, 30.0])
@pytest.mark.parametrize("orders", [4, 12])
def test_factors_are_bounded_by_the_anchors_odds(factor: float, orders: int) -> None:
    # The mixture is at least each anchor's odds times its own product; the cosine to the sun adds one peak at most. S is divided by
    # the probability of having come so far and of the connection.
    grid = DensityGrid.from_voxel_size(factor * noise_box().density, 1.0)
    plan = plan_orders(orders)
    of_asymmetry, of_extinction, orders_reached = largest_factors(draw(nodes_of(), 5000, grid=grid, plan=plan))
    assert (of_asymmetry <= 1.0001 / nodes_of().asymmetry_odds).all()
    traced = (plan.continuation.cumprod(0) * plan.connection)[orders_reached - 2, None]
    assert (of_extinction * traced <= 1.0001 * len(EXTINCTION)).all()


def test_forward_lobes_are_drawn_more_often() -> None:
    odds = nodes_of().asymmetry_odds
    assert float(odds.sum()) == pytest.approx(1.0)
    assert float(odds[3] / odds[1]) == pytest.approx(((1.0 - 0.2) / (1.0 - 0.85)) ** FORWARD_EXPONENT, rel=1e-5)
    assert odds.argmax() == 3
    assert odds.argmin() == 1


@pytest.mark.parametrize("column", [1, 2])
def test_ending_paths_and_leaving_out_connections_change_noise_but_no_mean(column: int) -> None:
    plan = plan_orders(8)
    ones = torch.ones_like(plan.continuation)
    whole = dataclasses.replace(plan, continuation=ones, connection=ones)
    mean, variance = moments(draw(nodes_of(), plan=plan))
    plain, plain_variance = moments(draw(nodes_of(), seed=5, plan=whole))
    assert torch.equal(plan.connection[[0, -1]], torch.tensor([1.0, 0.3], dtype=torch.float64))
    assert passes_z_test((mean - plain)[..., column], (variance + plain_variance)[..., column])
    # Without the division by the probabilities the high orders would be several times too dark.
    reached = (plan.continuation.cumprod(0) * plan.connection)[:, None, None]
    assert not passes_z_test((reached * mean - plain)[..., column], (variance + plain_variance)[..., column])


def test_a_path_does_not_depend_on_those_beside_it() -> None:
    together, alone = draw(nodes_of(), 300), draw(nodes_of(), 100, first=200)
    for many, few in zip(together, alone, strict=False):
        kept = many.path >= 200
        assert torch.equal(many.path[kept] - 200, few.path)
        torch.testing.assert_close(many.asymmetry_factor[kept], few.asymmetry_factor, rtol=1e-5, atol=0.0)
        torch.testing.assert_close(many.extinction_factor[kept], few.extinction_factor, rtol=1e-5, atol=0.0)
    assert not torch.equal(draw(nodes_of(), 100, first=100)[0].path, alone[0].path)


def test_no_random_number_is_used_twice() -> None:
    dimensions = [draw.of_order(order) for order in range(2, 20) for draw in Draw]
    assert dimensions == list(range(2, 2 + len(dimensions)))


def test_one_anchor_alone_is_not_bounded() -> None:
    of_asymmetry, of_extinction, _ = largest_factors(draw(nodes_of([-0.3], [3.0]), 5000))
    assert float(of_asymmetry.max()) > float(1.0 / nodes_of().asymmetry_odds.min()) / 0.7**3
    assert float(of_extinction.max()) > len(EXTINCTION)


def test_a_single_node_is_plain_path_tracing() -> None:
    """At the only anchor the flights' densities cancel: what remains is the transmittance to the sun."""
    nodes = TableNodes(ASYMMETRY[1:2], EXTINCTION[2:3], ASYMMETRY[1:2], EXTINCTION[2:3])
    for vertex in draw(nodes, 2000):
        assert (vertex.extinction_factor <= 1.0 + 1e-5).all()
        assert (vertex.extinction_factor > 0.0).all()


def test_orders_count_up_and_paths_only_end() -> None:
    vertices = draw(nodes_of(), 500)
    assert [v.order for v in vertices] == [2, 2, 3, 3, 4, 4]
    alive = set(range(500))
    for branch, vertex in zip(vertices[::2], vertices[1::2], strict=True):
        for one in (branch, vertex):
            numbers = set(one.path.tolist())
            assert numbers < alive
            assert len(numbers) == len(one.path) == len(one.asymmetry_factor) == len(one.extinction_factor)
        alive = numbers


def test_empty_volumes_have_no_second_vertex() -> None:
    vertices = draw(nodes_of(), 100, grid=DensityGrid.from_voxel_size(torch.zeros(6, 6, 6), 1.0))
    assert sum(len(vertex.path) for vertex in vertices) == 0


def test_a_seed_gives_the_same_paths_again() -> None:
    first, again, other = (draw(nodes_of(), 200, seed) for seed in (1, 1, 2))
    assert all(torch.equal(a.asymmetry_factor, b.asymmetry_factor) for a, b in zip(first, again, strict=True))
    assert not torch.equal(first[0].path, other[0].path)


def test_paths_have_no_scale() -> None:
    small = draw(nodes_of(), 500)
    thin = TableNodes(ASYMMETRY, EXTINCTION / 1024.0, ASYMMETRY, EXTINCTION / 1024.0)
    large = draw(thin, 500, grid=scaled(noise_box(), 1024.0), factor=1024.0)
    for first, second in zip(small, large, strict=True):
        assert torch.equal(first.path, second.path)
        torch.testing.assert_close(first.asymmetry_factor, second.asymmetry_factor)
        torch.testing.assert_close(first.extinction_factor, second.extinction_factor, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("asymmetry", [-0.99, 0.99])
def test_extremes_stay_finite(asymmetry: float) -> None:
    lobes, thickness = (
        torch.tensor([asymmetry, 0.999 * math.copysign(1.0, asymmetry)]),
        torch.tensor([1e-6, 1.0, 2000.0]),
    )
    if asymmetry < 0.0:
        lobes = lobes.flip(0)
    for anchors in (thickness, thickness[1:], thickness[:1]):
        for vertex in draw(TableNodes(lobes, thickness, lobes, anchors), 2000, grid=uniform_box()):
            assert torch.isfinite(vertex.asymmetry_factor).all()
            assert torch.isfinite(vertex.extinction_factor).all()


def test_z_scores_of_the_shared_paths_are_normal_on_the_whole() -> None:
    """Over the table, independent runs differ by as much as their variances say: neither too little nor too much."""
    first, second = (moments(draw(nodes_of(), seed=seed)) for seed in (21, 22))
    z = z_scores(first[0] - second[0], first[1] + second[1])
    assert 0.3 < float(z.square().mean()) < 2.5


def end_round_lobes(asymmetry: torch.Tensor) -> torch.Tensor:
    """Order 3 is the last of the first two asymmetries of the table."""
    return torch.where(asymmetry.abs() < 0.5, 3, 1 << 30)


def test_asymmetries_get_nothing_beyond_their_last_order() -> None:
    for vertex in draw(dataclasses.replace(nodes_of(), last_order=end_round_lobes), 5000):
        lit = (vertex.asymmetry_factor > 0.0).any(0)
        assert lit.tolist() == [vertex.order <= 3, vertex.order <= 3, True, True]


def test_paths_of_an_anchor_end_after_its_last_order() -> None:
    short = draw(dataclasses.replace(nodes_of([-0.3, 0.2]), last_order=end_round_lobes), 5000)
    assert {vertex.order for vertex in short if len(vertex.path)} == {2, 3}
    whole, mixed = draw(nodes_of(), 5000), draw(dataclasses.replace(nodes_of(), last_order=end_round_lobes), 5000)
    for all_, some in zip(whole, mixed, strict=True):
        if all_.order <= 3:
            assert torch.equal(all_.path, some.path)
            torch.testing.assert_close(all_.asymmetry_factor, some.asymmetry_factor)
        else:
            assert set(some.path.tolist()) < set(all_.path.tolist())


def test_traced_orders_keep_their_means_where_others_end() -> None:
    mean, variance = moments(draw(nodes_of(), seed=31))
    nodes = dataclasses.replace(nodes_of(), last_order=end_round_lobes)
    found, found_variance = moments(draw(nodes, seed=32))
    difference, spread = found - mean, variance + found_variance
    assert passes_z_test(difference[:2], spread[:2])
    assert passes_z_test(difference[2, 2:], spread[2, 2:])
    # Paths of the other anchors do not reach order four: with the odds of all anchors it would be too dark by theirs.
    going = float(nodes.asymmetry_odds[2:].sum())
    assert 0.7 < going < 0.8
    assert not passes_z_test(going * found[2, 2:] - mean[2, 2:], going**2 * found_variance[2, 2:] + variance[2, 2:])
    assert not found[2, :2].any()
