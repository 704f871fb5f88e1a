"""Carried orders: light is neither lost nor made, agrees with the reference path tracer, and does not depend on how it is computed."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import pytest
import torch

from precompute import carried_orders
from precompute.carried_orders import (
    CarriedOrders,
    CarryingEffort,
    carried_asymmetries,
    carry_orders,
    last_traced_orders,
    resolving_lattices,
)
from precompute.drawn_flights import draw_flights
from precompute.light_lattice import LightLattice, light_lattice_over
from precompute.order_plan import OrderPlan, place_knots, plan_orders
from precompute.path_sampler import EVERY_ORDER
from precompute.view import view_of
from render.density_grid import DensityGrid
from render.fused import fused_loops_wanted, torch_loops_only
from render.path_tracer import ReferenceImage, trace_reference
from render.spherical_harmonics import degrees_of_harmonics, evaluate_harmonics
from tests.support.carried import SUN, both_halves, cloud_view, plan_every_order, render_carried
from tests.support.volumes import noise_box, uniform_box, view_north

ASYMMETRY, DEGREE = torch.tensor([-0.3, 0.0, 0.5]), 3
EXTINCTION = torch.tensor([0.4, 1.0])
COARSEST = 1.0 / 32.0
EFFORT = CarryingEffort(DEGREE, 2, 3000, COARSEST, 3.5)


def carry(
    grid: DensityGrid,
    asymmetry: torch.Tensor = ASYMMETRY,
    extinction: torch.Tensor = EXTINCTION,
    plan: OrderPlan | None = None,
    seed: int = 0,
    spacing: float = 1.0,
) -> CarriedOrders:
    lattice = light_lattice_over(grid, spacing, 3000)
    view = view_of(grid, view_north(4, 4, 6.0), SUN)
    return carry_orders(view, (lattice, lattice), asymmetry, extinction, plan or plan_orders(18), EFFORT, 0.5, seed)


@pytest.mark.parametrize(
    ("asymmetry", "order"), [(0.0, 4), (0.3, 4), (0.5, 4), (0.8, 6), (0.95, 34), (0.99, 258), (-0.8, 6), (-0.95, 34)]
)
def test_a_forward_lobe_is_traced_until_it_is_round(asymmetry: float, order: int) -> None:
    found = int(last_traced_orders(torch.tensor([asymmetry]), DEGREE)[0])
    assert found == order
    left_out = abs(asymmetry) ** (found * (DEGREE + 1))
    assert left_out <= carried_orders.ROUND
    # The knot before would not do, or is none.
    knots = place_knots(EVERY_ORDER)
    before = knots[knots.index(found) - 1]
    assert before < 4 or abs(asymmetry) ** (before * (DEGREE + 1)) > carried_orders.ROUND


def test_last_traced_orders_rise_with_the_lobe_and_are_knots() -> None:
    asymmetry = torch.linspace(-0.999, 0.999, 801)
    found = last_traced_orders(asymmetry, DEGREE)
    assert set(found.tolist()) <= set(place_knots(EVERY_ORDER))
    assert torch.equal(found, found.flip(0))
    assert (found[400:].diff() >= 0).all()
    assert len(found.unique()) > 6


def test_a_lattice_that_does_not_resolve_free_paths_is_none() -> None:
    grid = noise_box(12)
    assert resolving_lattices(grid, 1.0, EFFORT) is not None
    assert resolving_lattices(grid, 1.0, replace(EFFORT, points=20)) is None
    thin = resolving_lattices(grid, 0.1, replace(EFFORT, points=300))
    assert thin is not None
    assert all(len(lattice.numbers) <= 330 for lattice in thin)
    cell_depth = 0.1 * grid.maximum * float(thin[0].lattice.spacing.max())
    assert cell_depth <= 3.5
    assert resolving_lattices(grid, 3.6, replace(EFFORT, points=10_000)) is None
    assert resolving_lattices(grid, 3.6, replace(EFFORT, points=10_000, deepest_cell=10.0)) is not None


def test_the_overlap_is_the_fourth_order() -> None:
    found = carry(noise_box(8))
    # Features are the orders two to four at every second asymmetry.
    for overlap, features in zip(found.overlap, found.features, strict=True):
        assert torch.allclose(overlap[..., :: carried_orders.FEATURE_STRIDE], features[..., -2:], rtol=1e-5)


def test_eight_asymmetries_are_carried_those_of_narrow_lobes_first() -> None:
    few, many = torch.linspace(-0.2, 0.9, 8), torch.linspace(0.0, 0.9, 11)
    assert carried_asymmetries(few) is few
    kept = carried_asymmetries(many)
    assert kept.tolist() == pytest.approx([0.0, 0.18, 0.36, 0.54, 0.63, 0.72, 0.81, 0.9])
    both = carried_asymmetries(torch.linspace(-0.9, 0.9, 21))
    assert both[[0, 1, -2, -1]].tolist() == pytest.approx([-0.9, -0.81, 0.81, 0.9])


def test_high_orders_need_no_high_harmonics(monkeypatch: pytest.MonkeyPatch) -> None:
    grid, asymmetry = noise_box(), torch.tensor([0.0, 0.5, 0.8])
    lattice, view = light_lattice_over(grid, 1.0, 3000), view_of(grid, view_north(4, 4, 6.0), SUN)

    def all_orders() -> torch.Tensor:
        carried = carry_orders(
            view, (lattice, lattice), asymmetry, EXTINCTION, plan_orders(34), replace(EFFORT, degree=5), 0.5, 0
        )
        return both_halves(carried).sum(3)

    some = all_orders()
    monkeypatch.setattr(carried_orders, "HIGH_ORDER", 99)
    whole = all_orders()
    error = (some - whole).square().mean((0, 1, 2)).sqrt() / whole.square().mean((0, 1, 2)).sqrt()
    assert float(error.max()) < 0.02
    assert float(error.max()) > 1e-5


def test_asymmetries_between_those_carried_are_interpolated(monkeypatch: pytest.MonkeyPatch) -> None:
    asymmetry = torch.linspace(0.0, 0.9, 11)
    some = both_halves(carry(noise_box(), asymmetry=asymmetry))
    monkeypatch.setattr(carried_orders, "CARRIED_ASYMMETRIES", 11)
    all_ = both_halves(carry(noise_box(), asymmetry=asymmetry))
    power = all_.square().mean((0, 1, 2)).sqrt()
    error = (some - all_).square().mean((0, 1, 2)).sqrt() / power.clamp(min=1e-30)
    assert float(error.max()) < 0.01
    assert float(error[:, [1, 3, 5]].max()) > 1e-4
    assert float(error[:, [0, 2, 4, 6, 7, 8, 9, 10]].max()) < 1e-4


@pytest.mark.skipif(not fused_loops_wanted(), reason="the fused loops are turned off")
@pytest.mark.parametrize("grid", [noise_box(), noise_box(9, sparse=0.8), uniform_box(voxels=(4, 1, 6))])
def test_fused_and_torch_carry_the_same(grid: DensityGrid) -> None:
    fused = both_halves(carry(grid))
    with torch_loops_only():
        plain = both_halves(carry(grid))
    largest = plain.amax((2, 3), keepdim=True)
    assert float(((fused - plain).abs() / largest).max()) < 2e-4
    other = both_halves(carry(grid, extinction=1.01 * EXTINCTION))
    assert float(((other - plain).abs() / largest).max()) > 2e-3


def test_threads_are_no_part_of_the_result() -> None:
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found.append(both_halves(carry(noise_box())))
    finally:
        torch.set_num_threads(before)
    torch.testing.assert_close(found[0], found[1], rtol=1e-5, atol=1e-9)
    assert not torch.equal(found[0][:, 0], found[0][:, 1])


def test_halves_and_seeds_differ_by_noise_alone() -> None:
    """Both halves have random numbers of their own: points differ by 13 to 40 per cent, means over them by a few."""
    first, other = (both_halves(carry(noise_box(), plan=plan_orders(10), seed=seed)).sum(3) for seed in (0, 1))
    for one, two in ((first[:, 0], first[:, 1]), (first[:, 0], other[:, 0])):
        spread = (one - two).square().mean(1).sqrt() / one.mean(1)
        assert (spread > 0.05).all()
        assert (spread < 0.5).all()
        torch.testing.assert_close(one.mean(1), two.mean(1), rtol=0.08, atol=0.0)
    assert torch.equal(first, both_halves(carry(noise_box(), plan=plan_orders(10), seed=0)).sum(3))


def test_shapes_and_progress() -> None:
    told: list[float] = []
    lattice = light_lattice_over(noise_box(), 1.0, 3000)
    view = view_of(noise_box(), view_north(4, 4, 6.0), SUN)
    plan = plan_orders(10)
    carried = carry_orders(view, (lattice, lattice), ASYMMETRY, EXTINCTION, plan, EFFORT, 0.5, 0, told.append)
    assert both_halves(carried).shape == (2, 2, len(lattice.numbers), len(plan.knots), 3)
    assert carried.at(1, torch.zeros(7, 3)).shape == (7, 2, len(plan.knots), 3)
    assert told == pytest.approx([0.075, 0.15, 0.225, 0.3, 0.475, 0.65, 0.825, 1.0])
    at_points = carried.at(1, lattice.positions).movedim(1, 0)
    torch.testing.assert_close(at_points, both_halves(carried)[1], rtol=1e-4, atol=1e-7)
    assert not torch.allclose(at_points, both_halves(carried)[0], rtol=1e-2)


def test_traced_orders_are_left_out() -> None:
    """With an image for every order, those up to the last that is traced are black, and the next is not."""
    asymmetry = torch.tensor([-0.8, 0.0, 0.5, 0.85])
    source = both_halves(carry(noise_box(), asymmetry, EXTINCTION[1:], plan_every_order(14)))[0, 0].mean(0)
    for column, last in enumerate(last_traced_orders(asymmetry, DEGREE).tolist()):
        lit = source[:, column] > 0.0
        assert lit.tolist() == [order > last for order in range(2, 15)]


def test_knots_hold_the_shares_of_their_orders() -> None:
    every = both_halves(carry(noise_box(), plan=plan_every_order(18)))
    plan = plan_orders(18)
    shared = torch.einsum("shpoa,ok->shpka", every.double(), plan.shares).float()
    found = both_halves(carry(noise_box(), plan=plan))
    torch.testing.assert_close(found, shared, rtol=1e-4, atol=1e-6)
    assert not torch.allclose(found, shared.roll(1, 3), rtol=1e-1)


# One order at a time, in a uniform cube with known chords.

CUBE, CUBE_DEPTH = uniform_box((6.0, 6.0, 6.0), (12, 12, 12)), 8.0


def scatter_once(light: torch.Tensor, asymmetry: float, depth: float) -> tuple[LightLattice, torch.Tensor]:
    """The next order of light `(harmonic,)` that is the same everywhere in the cube: `(harmonic, point)`, mean of eight sets."""
    lattice, extinction = light_lattice_over(CUBE, 1.0, 10_000), depth / 6.0
    view = view_of(CUBE, view_north(), SUN)
    count = len(lattice.numbers)
    keys = carried_orders.counter_keys(3, torch.arange(count))
    uniform = torch.rand(8, 3, generator=torch.Generator().manual_seed(2))
    sets = [carried_orders.turned_directions(DEGREE, one) for one in uniform]
    shifts = [carried_orders.counter_uniform(keys, turn) for turn in range(8)]
    s = torch.tensor([extinction])
    flights = [draw_flights(CUBE, lattice, one, s, shift, 0.5)[0] for one, shift in zip(sets, shifts, strict=True)]
    turns = [carried_orders._Turn(one, flight) for one, flight in zip(sets, flights, strict=True)]
    carrier = carried_orders._Carrier(view, lattice, extinction, 0.5, turns)
    damping = torch.tensor([asymmetry]) ** degrees_of_harmonics(DEGREE, odd=True)[:, None]
    results = []
    for turn in turns:
        values = light[:, None, None].expand(-1, count, 1).clone()
        carrier._scatter(values, damping, turn, carried_orders._Space.like(values))
        results.append(values[..., 0])
    return lattice, torch.stack(results).mean(0)


def collided_share(positions: torch.Tensor, extinction: float) -> torch.Tensor:
    """Share of the flights from points `(point, 3)` of the cube that end inside: one less the mean transmittance of the chords."""
    directions = torch.nn.functional.normalize(torch.randn(4000, 3, generator=torch.Generator().manual_seed(5)), dim=1)
    chord = ((3.0 - positions[:, None] * directions.sign()) / directions.abs()).amin(-1)
    return 1.0 - torch.exp(-extinction * chord).mean(1)


@pytest.mark.parametrize("depth", [2.0, CUBE_DEPTH])
def test_an_even_field_loses_what_flies_out(depth: float) -> None:
    light = torch.zeros((DEGREE + 1) ** 2)
    light[0] = 1.0
    lattice, found = scatter_once(light, 0.6, depth)
    for factor, right in ((1.0, True), (1.1, False)):
        exact = collided_share(lattice.positions, factor * depth / 6.0)
        # 256 flights of each point, and 1728 points.
        assert (abs(float((found[0] - exact).mean())) < 3e-3) is right
        assert float((found[0] - exact).square().mean().sqrt()) < 0.06


@pytest.mark.parametrize("asymmetry", [0.6, -0.4, 0.0])
def test_deep_inside_each_harmonic_is_damped_by_its_moment(asymmetry: float) -> None:
    """In the middle of 60 mean free paths no flight leaves, and scattering multiplies degree l by g^l: nothing goes to others."""
    direction = torch.nn.functional.normalize(torch.tensor([0.3, -0.5, 0.8], dtype=torch.float64), dim=0)
    light = evaluate_harmonics(direction, DEGREE).float()
    lattice, found = scatter_once(light, asymmetry, 60.0)
    inner = found[:, lattice.positions.abs().amax(1) < 1.0]
    degrees = degrees_of_harmonics(DEGREE, odd=True)
    exact = (torch.tensor(asymmetry) ** degrees * light)[:, None].expand_as(inner)
    torch.testing.assert_close(inner, exact, atol=2e-5, rtol=0.0)
    assert not torch.allclose(inner, (torch.tensor(asymmetry + 0.01) ** degrees * light)[:, None], atol=1e-3)


def test_no_order_is_brighter_than_the_one_before_at_its_brightest() -> None:
    """Each value of isotropic light is a mean of the order before, so neither its largest value nor, in a thick box, its sum rises."""
    source = both_halves(carry(CUBE, torch.zeros(1), torch.tensor([4.0]), plan_every_order(30)))[0, ..., 0].mean(0)
    orders = source[:, 3:]
    largest, total = orders.amax(0), orders.mean(0).double()
    assert (largest[1:] <= 1.005 * largest[:-1]).all()
    ratio = total[1:] / total[:-1]
    assert (ratio < 1.0).all()
    # Escape from the lit surface slows down as light diffuses inwards: like k^(-3/2) for the flux, k^(-1/2) for what is inside.
    assert (ratio[4:] > 0.9).all()
    assert float(ratio[-1]) > float(ratio[0])
    numbers = torch.arange(5, 5 + len(total), dtype=torch.float64)
    slope = torch.log(total[-1] / total[8]) / torch.log(numbers[-1] / numbers[8])
    assert -0.75 < float(slope) < -0.4


@pytest.mark.parametrize("depth", [1e-4, 10.0, 1000.0, 1e5])
def test_any_depth_stays_finite_and_within_bounds(depth: float) -> None:
    grid, lobes = noise_box(), torch.tensor([-0.95, 0.0, 0.9])
    source = both_halves(carry(grid, lobes, torch.tensor([depth / 6.0]), plan_orders(258)))
    assert torch.isfinite(source).all()
    # No order of isotropic light is brighter than the sun's, 1 / (4 pi) where the sun shines fully; half as much again for sharpening.
    assert float(source[..., 1].abs().max()) < 1.5 / (4.0 * math.pi) * 254.0
    assert bool((source[..., 1].amax() > 1e-3) == (depth == 10.0))


def without_tail(*arguments: object) -> None:
    """Nothing is added."""


@pytest.mark.parametrize("depth", [0.01, 0.1, 1.0])
def test_orders_without_light_have_no_tail(depth: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a thin box the orders behind a lobe are noise of either sign, whose roots are no numbers and whose ratios mean nothing."""
    cases = [(seed, lobe) for seed in range(2) for lobe in torch.tensor([-0.95, -0.6, 0.0, 0.9])]
    thin = torch.tensor([depth / 4.0])
    found = [both_halves(carry(noise_box(4), lobe[None], thin, plan_orders(66), seed)) for seed, lobe in cases]
    monkeypatch.setattr(carried_orders._Carrier, "_extend", staticmethod(without_tail))
    for (seed, lobe), source in zip(cases, found, strict=True):
        cut = both_halves(carry(noise_box(4), lobe[None], thin, plan_orders(66), seed))
        # A tail at the slowest decay that is allowed would hold the last order tens of times.
        assert torch.isfinite(source).all()
        assert float((source - cut).abs().max()) <= float(cut.abs().max())


def test_no_pattern_of_the_lattice_grows_behind_a_narrow_lobe(monkeypatch: pytest.MonkeyPatch) -> None:
    """Light falls from order to order; where all harmonics were sharpened it did not."""
    view = cloud_view()
    extinction = torch.tensor([57.0 / view.largest_optical_length])
    lattice = light_lattice_over(view.grid, 1.0, 3000)
    plan = plan_every_order(carried_orders.LAST_CARRIED)

    def decay() -> float:
        """Ratio of the last orders to those twelve before."""
        carried = carry_orders(view, (lattice, lattice), torch.tensor([0.93]), extinction, plan, EFFORT, 0.5, 0)
        of_order = both_halves(carried)[0, ..., 0].square().mean((0, 1)).sqrt()
        return float((of_order[-1] / of_order[-13]) ** (1.0 / 12.0))

    steady = decay()
    monkeypatch.setattr(carried_orders, "SHARPENED_DEGREE", DEGREE)
    assert steady < 0.98
    assert decay() > 1.0


# Against the reference path tracer.

CLOUD_ASYMMETRY = 0.3


@cache
def reference(extinction: float) -> ReferenceImage:
    view = cloud_view()
    arguments = {"asymmetry": CLOUD_ASYMMETRY, "albedo": 1.0, "orders": 18, "samples": 4000}
    return trace_reference(view.grid, view.camera, view.sun, extinction=extinction, **arguments)  # type: ignore[arg-type]


def relative_errors() -> tuple[float, float]:
    """Errors of orders 5 to 18 at an optical depth of 8, over the reference: of the mean image, and RMS over pixels."""
    view = cloud_view()
    extinction = torch.tensor([8.0 / view.largest_optical_length])
    exact = reference(float(extinction)).orders[4:].sum(0)[view.pixel]
    found = []
    for seed in range(4):
        lattices = resolving_lattices(view.grid, float(extinction), EFFORT)
        assert lattices is not None
        asymmetry = torch.tensor([CLOUD_ASYMMETRY])
        carried = carry_orders(view, lattices, asymmetry, extinction, plan_orders(18), EFFORT, 0.5, seed)
        found.append(render_carried(carried, view, extinction, 0)[..., 0].mean(0))
    image = torch.stack(found).mean(0)
    return float(image.mean() / exact.mean() - 1.0), float((image - exact).square().mean().sqrt() / exact.mean())


def test_a_cloud_is_that_of_the_reference_path_tracer() -> None:
    of_mean, of_pixels = relative_errors()
    # Four runs and the reference have a noise of 1 per cent each in the mean, the reference one of 5 per cent in a pixel.
    assert abs(of_mean) < 0.03
    assert of_pixels < 0.08


def without_spread(self: LightLattice, positions: Iterator[torch.Tensor]) -> torch.Tensor:
    for _ in positions:
        continue
    return torch.zeros(len(self.numbers))


def test_without_sharpening_light_leaks_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LightLattice, "measure_spread", without_spread)
    assert relative_errors()[0] < -0.06


@pytest.mark.parametrize("factor", [0, -1])
def test_a_wrong_damping_gives_another_cloud(factor: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exponents 0 keep all light as it flies; -1 makes degree l brighter instead of fainter."""
    right = carried_orders.degrees_of_harmonics
    monkeypatch.setattr(carried_orders, "degrees_of_harmonics", lambda degree, odd: factor * right(degree, odd=odd))
    of_mean = relative_errors()[0]
    assert not abs(of_mean) < 0.3


@pytest.mark.parametrize("extinction", [1.0, 2.0])
def test_the_orders_beyond_the_last_carried_follow_its_law(extinction: float, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = (noise_box(8), ASYMMETRY, torch.tensor([extinction]), plan_orders(66))
    whole = both_halves(carry(*arguments)).sum(3).mean((0, 1, 2))
    monkeypatch.setattr(carried_orders, "LAST_CARRIED", 24)
    extended = both_halves(carry(*arguments)).sum(3).mean((0, 1, 2))
    monkeypatch.setattr(carried_orders._Carrier, "_extend", staticmethod(without_tail))
    cut = both_halves(carry(*arguments)).sum(3).mean((0, 1, 2))
    assert (cut < whole).all()
    assert ((extended - whole).abs() < 0.2 * (whole - cut)).all()


def test_faint_orders_end_early_without_a_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    thin = torch.tensor([0.05])
    arguments = (noise_box(), ASYMMETRY, thin, plan_orders(66))
    early = both_halves(carry(*arguments))
    monkeypatch.setattr(carried_orders, "FAINT", 0.0)
    whole = both_halves(carry(*arguments))
    total = whole.sum(3).mean((0, 1, 2))
    torch.testing.assert_close(early.sum(3).mean((0, 1, 2)), total, rtol=0.02, atol=0.0)
    assert not torch.equal(early, whole)
    assert math.isfinite(float(total.sum()))
