"""One group of extinctions: as many orders and paths as its tolerance needs, and a report of what was done."""

import dataclasses
import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from types import SimpleNamespace

import pytest
import torch

from precompute import group_task, source_group
from precompute.carried_orders import CarriedOrders
from precompute.error_budget import ALBEDOS, OMITTED_SHARE, Effort, StopReason, box_error
from precompute.group_task import LARGEST_STEP, SMALLEST_STEP, THIN_POINTS, THINNEST_ANCHOR, GroupTask
from precompute.light_lattice import LightLattice
from precompute.source_group import GroupImages, build_group
from precompute.source_points import THICK_SPACING
from precompute.view import View, view_of
from render.density_grid import DensityGrid
from render.fused import torch_loops_only
from render.phase_functions import evaluate_phase_function
from tests.support.volumes import smooth_box, towards, view_north

ASYMMETRY = torch.tensor([0.0, 0.6])
ALBEDO = torch.tensor(ALBEDOS)
KNOTS = (2, 3, 4, 6, 10, 18)
EFFORT = Effort(orders=18, points=500, paths=100_000, strata=8)


def seen() -> View:
    return view_of(smooth_box(12, 12.0), view_north(16, 12, 18.0), towards(120.0, 30.0))


def task(depths: list[float], seed: int = 0, view: View | None = None, **changes: object) -> GroupTask:
    """Nodes of given largest optical depths."""
    rays = view or seen()
    extinction = torch.tensor(depths) / rays.largest_optical_length
    effort = dataclasses.replace(EFFORT, **changes)  # type: ignore[arg-type]
    return GroupTask(rays, ASYMMETRY, extinction, ALBEDO, effort, seed)


def build(depths: list[float], seed: int = 0, **changes: object) -> GroupImages:
    return build_group(task(depths, seed, **changes), lambda share: None)


def composed(images: GroupImages, count: int | None = None) -> torch.Tensor:
    """Scattered light `(albedo, asymmetry, extinction, pixel)` with some of the images, all by default."""
    multiple = images.multiple[:count]
    knots = list(KNOTS[: len(multiple)])
    view = seen()
    phase = evaluate_phase_function(view.direction @ view.sun, ASYMMETRY[:, None])
    single = ALBEDO[:, None, None, None] * phase[:, None] * images.single
    powers = ALBEDO[:, None] ** torch.tensor(knots)
    return (single + torch.einsum("ak,kgsp->agsp", powers, multiple)).double()


def relative_change(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    return ((first - second).square().mean(-1) / second.square().mean(-1)).sqrt()


def test_a_group_has_its_shapes_and_numbers() -> None:
    images = build([10.0, 20.0], orders=6)
    pixels = len(seen().pixel)
    assert images.single.shape == (2, pixels)
    assert images.multiple.shape == (4, 2, 2, pixels)
    assert images.standard_error.shape == images.effective_share.shape == (4, 2, 2)
    assert images.image_error.shape == (len(ALBEDOS), 2, 2)
    assert all(torch.isfinite(getattr(images, f.name)).all() for f in dataclasses.fields(images) if f.name != "report")
    assert (images.multiple >= 0.0).all()


def test_the_report_says_what_was_done() -> None:
    images = build([10.0, 20.0], orders=6)
    report = images.report
    assert (report.thinnest, report.thickest) == pytest.approx((10.0, 20.0), rel=1e-5)
    assert (report.largest_order, report.omitted_share) == (6, 0.0)
    assert 300 < report.points < 700
    assert 70_000 < report.paths < 140_000
    assert report.spacing >= THICK_SPACING
    assert report.error == pytest.approx(box_error(images.image_error), rel=1e-5)
    assert report.stop_reason == StopReason.FIXED.value
    assert {"single scattering", "paths", "images"} <= report.seconds.keys()
    assert all(seconds >= 0.0 for seconds in report.seconds.values())
    assert set(asdict(report)) == {field.name for field in dataclasses.fields(report)}


@pytest.mark.parametrize("tolerance", [None, 0.03, 0.5])
def test_progress_comes_to_the_whole_once(tolerance: float | None) -> None:
    shares: list[float] = []
    build_group(task([2.0], tolerance=tolerance), shares.append)
    assert all(0.0 < share <= 1.0 for share in shares)
    assert shares[-1] == 1.0
    assert shares.count(1.0) == 1


@pytest.mark.parametrize("tolerance", [0.2, 0.05])
def test_thin_clouds_scatter_once_and_that_is_enough(tolerance: float) -> None:
    images = build([0.001, 0.01], tolerance=tolerance)
    assert images.report.stop_reason == StopReason.SINGLE.value
    assert images.report.largest_order == 1
    assert images.standard_error.shape == images.effective_share.shape == (0, 2, 2)
    assert (images.report.paths, images.report.points) == (0, 0)
    assert 0.0 < images.report.omitted_share <= OMITTED_SHARE * tolerance
    assert images.image_error.unique().tolist() == pytest.approx([images.report.omitted_share])
    whole = build([0.001, 0.01], orders=4)
    change = relative_change(composed(images, 0), composed(whole))
    assert float(change.max()) < tolerance
    # What is left out without the pilot's images is what the report says, at the node where it is largest.
    left_out = 1.0 - composed(images, 0).mean(-1) / composed(whole).mean(-1)
    assert float(left_out.max()) == pytest.approx(images.report.omitted_share, rel=0.2)
    assert float(relative_change(composed(images), composed(whole)).max()) < 0.5 * float(change.max())


def test_thicker_clouds_need_more_than_one_scattering() -> None:
    images, whole = build([2.0], tolerance=0.2), build([2.0], orders=4)
    assert images.report.largest_order > 1
    assert float(relative_change(composed(whole, 0), composed(whole)).min()) > 0.2


def test_more_orders_are_traced_for_thicker_clouds_and_smaller_tolerances() -> None:
    by_depth = [build([depth], tolerance=0.05).report.largest_order for depth in (0.001, 0.05, 0.2, 2.0, 20.0)]
    assert by_depth == sorted(by_depth)
    assert (by_depth[0], by_depth[-1]) == (1, 18)
    by_tolerance = [build([2.0], tolerance=tolerance).report.largest_order for tolerance in (0.3, 0.1, 0.02)]
    assert by_tolerance == sorted(by_tolerance)
    assert by_tolerance[0] < by_tolerance[-1]


def test_orders_that_are_carried_in_thick_groups_leave_none_out() -> None:
    thin, thick = (build([depth], tolerance=0.1, orders=258) for depth in (12.0, 30.0))
    assert 1 < thin.report.largest_order < 258
    assert thin.report.omitted_share > 0.0
    assert thick.report.carried_points > 0
    assert (thick.report.largest_order, thick.report.omitted_share) == (258, 0.0)


def test_what_both_halves_miss_is_in_the_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    stated = []
    factors = group_task.UNSEEN_ERROR, group_task.ROUGH_UNSEEN_ERROR
    for unseen, rough in (factors, (1.0, 1.0)):
        monkeypatch.setattr(group_task, "UNSEEN_ERROR", unseen)
        monkeypatch.setattr(group_task, "ROUGH_UNSEEN_ERROR", rough)
        stated.append([build([depth], tolerance=0.1, paths=1) for depth in (0.5, 10.0, 30.0)])
    assert [one.report.carried_points > 0 for one in stated[0]] == [False, True, True]
    for one, plain, factor in zip(*stated, (factors[0], *factors), strict=True):
        for name in ("standard_error", "image_error", "bright_error"):
            torch.testing.assert_close(getattr(one, name), factor * getattr(plain, name))


def test_the_orders_left_out_would_not_have_mattered() -> None:
    """The tolerance meets the sum over all orders that a dear build without tolerance has."""
    images = build([0.2, 2.0], tolerance=0.1)
    traced = KNOTS.index(images.report.largest_order) + 1
    assert len(images.standard_error) == traced < len(images.multiple) == len(KNOTS)
    dear = build([0.2, 2.0], seed=9, orders=18, paths=1_000_000)
    change = relative_change(composed(images, traced), composed(dear))
    assert images.report.stop_reason == StopReason.TOLERANCE.value
    assert float(change.max()) < 0.1
    assert 0.0 < images.report.omitted_share <= OMITTED_SHARE * 0.1


@pytest.mark.parametrize("tolerance", [0.2, 0.06, 0.03])
def test_paths_are_added_until_the_tolerance_is_met(tolerance: float) -> None:
    images = build([2.0, 4.0], tolerance=tolerance, paths=1_000_000)
    assert images.report.stop_reason == StopReason.TOLERANCE.value
    assert images.report.error <= tolerance
    dear = build([2.0, 4.0], seed=9, orders=images.report.largest_order, paths=1_000_000)
    traced = len(images.standard_error)
    change = relative_change(composed(images, traced), composed(dear))
    assert box_error(change) < 1.2 * tolerance


def test_images_that_were_not_traced_have_the_pilot_s_mean() -> None:
    """Faint as they are, interpolation over the extinction needs them to be about right."""
    images, dear = build([0.05, 0.2], tolerance=0.1), build([0.05, 0.2], seed=9, paths=1_000_000)
    traced = len(images.standard_error)
    assert traced < 3
    assert images.multiple.shape == dear.multiple.shape
    mean, right = images.multiple.mean(-1), dear.multiple.mean(-1)
    assert float((mean[traced] / right[traced]).log().abs().max()) < 0.5
    assert float(((mean - right)[traced:].abs().sum(0) / right.sum(0)).max()) < 0.05
    assert (images.multiple >= 0.0).all()
    for number in range(max(traced, 1), 3):  # so few paths reach no further
        last = images.multiple[number - 1] / images.multiple[number - 1].mean(-1, keepdim=True)
        own = images.multiple[number] / images.multiple[number].mean(-1, keepdim=True)
        torch.testing.assert_close(own, last, rtol=1e-4, atol=1e-6)


def test_smaller_tolerances_cost_more_paths() -> None:
    paths = [build([2.0], tolerance=tolerance, paths=400_000).report.paths for tolerance in (0.03, 0.015, 0.0075)]
    assert paths[0] < paths[1] < paths[2]


def test_the_largest_number_of_paths_ends_it() -> None:
    report = build([10.0, 20.0], tolerance=1e-4).report
    assert report.stop_reason == StopReason.PATHS.value
    assert report.error > 1e-4
    assert 60_000 < report.paths < 140_000


def test_time_ends_it() -> None:
    report = build([10.0, 20.0], tolerance=1e-4, paths=10**9, points=200, max_seconds=1e-3, orders=4).report
    assert report.stop_reason == StopReason.SECONDS.value
    assert report.paths < 10**9


def test_torch_loops_make_the_same_decisions_and_images() -> None:
    pytest.importorskip("numba")
    fused = build([1.0, 2.0], tolerance=0.06)
    with torch_loops_only():
        plain = build([1.0, 2.0], tolerance=0.06)
    assert dataclasses.replace(fused.report, seconds={}, error=0.0, omitted_share=0.0) == dataclasses.replace(
        plain.report, seconds={}, error=0.0, omitted_share=0.0
    )
    assert fused.report.error == pytest.approx(plain.report.error, rel=1e-3)
    torch.testing.assert_close(fused.multiple, plain.multiple, rtol=2e-4, atol=1e-7)


def test_steps_follow_the_depth_of_the_densest_voxel() -> None:
    view = seen()
    voxel = view.grid.maximum * float(view.grid.voxel_size.min()) / view.largest_optical_length
    assert task([1e-3]).step == LARGEST_STEP
    assert task([1e3]).step == SMALLEST_STEP
    assert task([0.1, 1.0 / voxel]).step == pytest.approx(0.5, rel=1e-5)


def test_anchors_are_the_nodes_that_are_thick_enough() -> None:
    anchors = task([0.01, 0.4, 0.6, 5.0]).nodes().extinction_anchors * seen().largest_optical_length
    assert anchors.tolist() == pytest.approx([0.6, 5.0])
    assert anchors.min() >= THINNEST_ANCHOR
    assert task([0.01, 0.1]).nodes().extinction_anchors.tolist() == pytest.approx([0.1 / seen().largest_optical_length])


def test_pilot_and_group_draw_different_numbers() -> None:
    from precompute.gather import lattice_over
    from precompute.order_plan import plan_orders
    from precompute.source_points import SourcePoints

    group, sources = task([2.0]), []
    for seed, stream in ((0, 0), (0, 1), (1, 0), (1, 1)):
        table = dataclasses.replace(group, seed=seed).source_table(
            lattice_over(group.view.grid, 1.0), plan_orders(2), group.nodes(), stream
        )
        table.add_pass(SourcePoints(torch.arange(50), torch.full((50,), 8)))
        sources.append(table.source)
    assert all(not torch.equal(a, b) for n, a in enumerate(sources) for b in sources[:n])


def test_a_volume_of_one_voxel_and_rays_that_hardly_touch_it() -> None:
    view = view_of(DensityGrid.from_voxel_size(torch.ones(1, 1, 1), 1.0), view_north(3, 3, 1.2), towards(120.0, 30.0))
    for tolerance in (None, 0.05):
        images = build_group(task([0.01, 5.0], view=view, tolerance=tolerance, paths=20_000), lambda share: None)
        assert torch.isfinite(images.multiple).all()
        assert math.isfinite(images.report.error)


class ListedErrors:
    """A smoother that knows the error at each extinction, and tells which were asked for."""

    def __init__(self, errors: list[float]) -> None:
        self.errors, self.asked = errors, list[int]()

    def at(self, nodes: Iterable[int]) -> Iterator[SimpleNamespace]:
        for node in nodes:
            self.asked.append(node)
            yield SimpleNamespace(errors=SimpleNamespace(of_image=torch.full((1, 1), self.errors[node])))


@pytest.mark.parametrize(
    ("errors", "found", "asked"),
    [
        ([0.01, 0.01, 0.01, 0.01, 0.01], 0.01, [4, 1, 0, 1, 2, 3, 4]),
        # Where those that are looked at first seem well, the others have to be.
        ([0.09, 0.01, 0.09, 0.09, 0.01], 0.09, [4, 1, 0, 1, 2, 3, 4]),
        ([0.01, 0.09, 0.01, 0.01, 0.09], 0.09, [4, 1]),
    ],
)
def test_a_tolerance_is_met_at_all_extinctions_or_not_at_all(
    errors: list[float], found: float, asked: list[int]
) -> None:
    smoother = ListedErrors(errors)

    def gather() -> tuple[torch.Tensor, list[SimpleNamespace]]:
        return torch.empty(0), [one.errors for one in smoother.at(range(len(errors)))]

    error, images = source_group._error_so_far(smoother, gather, len(errors), 0.02)  # type: ignore[arg-type]
    assert error == pytest.approx(found)
    assert smoother.asked == asked
    # Images that were made to be judged are not made again.
    assert (images is not None) == (len(asked) > len(errors))


@pytest.mark.parametrize(("depth", "thick"), [(12.0, False), (30.0, True)])
def test_only_thick_groups_are_sharpened_and_have_all_points(
    depth: float, thick: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    sharp = build([depth], orders=3)
    monkeypatch.setattr(LightLattice, "sharpen", lambda _, values: values)
    plain = build([depth], orders=3)
    change = (sharp.multiple.double().mean(-1) / plain.multiple.double().mean(-1) - 1.0).abs()
    assert (1e-3 < float(change.max()) < 0.1) is thick
    assert (float(change.max()) == 0.0) is not thick
    assert task([depth]).points(EFFORT) == (EFFORT.points if thick else round(THIN_POINTS * EFFORT.points))


def test_carried_light_agrees_with_paths_in_the_last_image_that_both_know(monkeypatch: pytest.MonkeyPatch) -> None:
    """Carried light that is a fifth too dark, in what paths know as well as beyond, is as bright as ever in the images."""
    right = build([30.0], orders=258)
    carry = group_task.carry_orders

    def carry_too_little(*arguments: object) -> CarriedOrders:
        carried = carry(*arguments)  # type: ignore[arg-type]
        source, overlap = (tuple(0.8 * half for half in halves) for halves in (carried.source, carried.overlap))
        return dataclasses.replace(carried, source=source, overlap=overlap)

    monkeypatch.setattr(group_task, "carry_orders", carry_too_little)
    dark = build([30.0], orders=258)
    assert right.report.carried_points > 0
    assert torch.allclose(dark.multiple.mean(-1), right.multiple.mean(-1), rtol=0.02)
    monkeypatch.setattr(source_group, "MATCHES", (1.0, 1.0))
    unmatched = build([30.0], orders=258)
    high = slice(3, None)
    assert (unmatched.multiple[high].mean(-1) < 0.9 * right.multiple[high].mean(-1)).all()
