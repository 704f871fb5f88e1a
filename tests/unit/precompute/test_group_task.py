"""How finely the rays of a group are cut."""

import pytest
import torch

from precompute import group_task
from precompute.error_budget import ALBEDOS, Effort
from precompute.group_task import LARGEST_STEP, SECTIONS_PER_STRATUM, SMALLEST_STEP, GroupTask
from precompute.order_plan import plan_orders
from precompute.view import view_of
from tests.support.volumes import smooth_box, towards, view_north

STRATA = 8


def task(depth: float, tolerance: float | None) -> GroupTask:
    """One node of a largest optical depth."""
    view = view_of(smooth_box(12, 12.0), view_north(16, 12, 18.0), towards(120.0, 30.0))
    extinction = torch.tensor([depth]) / view.largest_optical_length
    effort = Effort(orders=18, points=500, paths=100_000, strata=STRATA, tolerance=tolerance)
    return GroupTask(view, torch.tensor([0.0, 0.6]), extinction, torch.tensor(ALBEDOS), effort, 0)


def test_sections_follow_the_tolerance_and_the_depth() -> None:
    assert task(20.0, None).sections == task(20.0, 0.5).sections == SECTIONS_PER_STRATUM * STRATA
    assert task(20.0, 0.02).sections == 64
    assert task(20.0, 0.005).sections == 256
    assert 25 < task(0.4, 0.02).sections < 32


def test_strata_are_fewer_in_thin_clouds() -> None:
    assert task(20.0, None).strata == task(2.0, None).strata == STRATA
    assert task(0.49, None).strata == STRATA // 2
    assert 1 < task(1e-6, None).strata < STRATA


def test_rough_tables_take_longer_steps() -> None:
    assert task(1e4, None).step == task(1e4, 0.02).step == SMALLEST_STEP
    assert SMALLEST_STEP < task(1e4, 0.1).step < LARGEST_STEP
    assert task(1e-4, 0.1).step == task(1e-4, 0.02).step == LARGEST_STEP


def test_rough_tables_carry_light_on_fewer_points(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(group_task, "ROUGH_POINTS", 500)
    plan = plan_orders(18)
    both = []
    for one in (task(20.0, tolerance) for tolerance in (0.1, 0.02)):
        lattices = one.lattices(plan.largest_order, 500)
        assert lattices is not None
        both.append(one.carry(plan, lattices, 500, lambda share: None))
    rough, fine = both
    assert rough.points < fine.points
    assert rough.degree < fine.degree


def test_few_orders_or_too_deep_a_cloud_are_not_carried() -> None:
    assert task(20.0, 0.02).lattices(18, 500) is not None
    assert task(20.0, 0.02).lattices(10, 500) is None
    assert task(1e4, 0.02).lattices(258, 500) is None
    assert task(20.0, 0.02).thick_lattices is not None
    assert task(19.0, 0.02).thick_lattices is None
    assert task(1e4, 0.02).thick_lattices is None
