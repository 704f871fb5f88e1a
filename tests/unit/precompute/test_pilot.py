"""What a pilot says is needed, and what stands for the rest."""

from dataclasses import replace

import pytest
import torch

from precompute.error_budget import ALBEDOS, OMITTED_SHARE, Effort
from precompute.group_task import THICK_DEPTH, GroupTask
from precompute.order_plan import plan_orders
from precompute.pilot import FAINT_SHARE, PILOT_PATHS, PILOT_POINTS, Pilot, fly_pilot
from precompute.single_scattering import compute_single_scattering
from precompute.view import view_of
from tests.support.rays import stratify_rays
from tests.support.volumes import smooth_box, towards, view_north

PLAN = plan_orders(10)
EFFORT = Effort(orders=10, points=50_000, paths=1_000_000, tolerance=0.02)


def pilot(enough: int, multiple: float = 1.0) -> Pilot:
    mean = torch.tensor([4.0, 2.0, 1.0, 0.5, 0.25], dtype=torch.float64)[:, None, None]
    return Pilot(PLAN, enough, 0.003, multiple, mean)


def fly(depth: float, tolerance: float | None) -> Pilot:
    view = view_of(smooth_box(12, 12.0), view_north(16, 12, 18.0), towards(120.0, 30.0))
    extinction = torch.tensor([depth]) / view.largest_optical_length
    effort = replace(EFFORT, orders=66, tolerance=tolerance)
    task = GroupTask(view, torch.tensor([0.0, 0.6]), extinction, torch.tensor(ALBEDOS), effort, 0)
    rays = (view.grid, view.origin, view.direction)
    strata = stratify_rays(*rays, extinction, task.strata)
    single, _ = compute_single_scattering(*rays, view.sun, extinction, task.step, task.sections)
    return fly_pilot(task, strata, single)


def test_needed_orders_are_those_of_the_images() -> None:
    assert [pilot(enough).needed.largest_order for enough in (1, 2, 3, 4, 5)] == [2, 3, 4, 6, 10]


def test_all_orders_leave_nothing_out() -> None:
    whole = Pilot.of_all_orders(10)
    assert (whole.needed.largest_order, whole.omitted, whole.mean) == (10, 0.0, None)


def test_images_that_were_not_traced_have_the_means_of_the_pilot_and_the_last_shape() -> None:
    traced = torch.tensor([[1.0, 3.0], [2.0, 6.0], [1.0, 5.0]])[:, None, None]
    images = pilot(3).complete(traced, torch.ones(1, 1, 2))
    assert torch.equal(images[:3], traced)
    torch.testing.assert_close(images[3:].flatten(1), torch.tensor([[0.5 / 3.0, 2.5 / 3.0], [0.25 / 3.0, 1.25 / 3.0]]))
    alone = pilot(0).complete(torch.empty(0), torch.tensor([[[1.0, 3.0]]]))
    torch.testing.assert_close(alone.mean(-1).flatten(), torch.tensor([4.0, 2.0, 1.0, 0.5, 0.25]))


@pytest.mark.parametrize(("multiple", "less"), [(0.5 * FAINT_SHARE, True), (2.0 * FAINT_SHARE, False)])
def test_faint_light_is_worth_less(multiple: float, less: bool) -> None:
    suited = pilot(5, multiple * 0.02).suited(EFFORT)
    assert (suited.points < EFFORT.points) == (suited.paths < EFFORT.paths) == less
    least = pilot(5, multiple * 0.02).suited(replace(EFFORT, points=PILOT_POINTS, paths=PILOT_PATHS))
    assert (least.points, least.paths) == (PILOT_POINTS, PILOT_PATHS)


def test_orders_follow_from_the_tolerance() -> None:
    coarse, fine = fly(4.0, 0.2), fly(4.0, 0.01)
    assert 0 < coarse.enough < fine.enough
    assert fine.omitted <= OMITTED_SHARE * 0.01 < coarse.omitted <= OMITTED_SHARE * 0.2
    assert fine.multiple == pytest.approx(coarse.multiple, rel=0.01)
    assert fine.mean is not None
    assert bool((fine.mean[: fine.enough] > 0.0).all())


def test_without_a_tolerance_every_order_is_needed_and_nothing_flown() -> None:
    everything = fly(4.0, None)
    assert everything.enough == len(everything.plan.knots)
    assert everything.mean is None


def test_thick_groups_that_carry_light_need_no_pilot() -> None:
    thin, thick = fly(0.9 * THICK_DEPTH, 0.2), fly(THICK_DEPTH, 0.2)
    assert thin.enough < len(thin.plan.knots)
    assert thin.mean is not None
    assert thick.enough == len(thick.plan.knots)
    assert thick.mean is None
