"""How finely the rays of a group are cut."""

import torch

from precompute.error_budget import ALBEDOS, Effort
from precompute.group_task import SECTIONS_PER_STRATUM, GroupTask
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
