"""Sentences about what a stack models."""

from dataclasses import asdict, replace

from cloudfit.stack_report import describe_groups
from precompute.error_budget import GroupReport, StopReason

THIN = GroupReport(0.05, 1.5, 1, 0.004, 0, 0.0, 0, 0, 0.004, StopReason.SINGLE.value, {"pilot": 0.5, "rays": 0.25})
THICK = GroupReport(30.0, 60.0, 66, 0.0, 12345, 1.25, 6_000_000, 0, 0.0312, StopReason.PATHS.value, {"paths": 20.0})


def test_every_group_is_a_sentence_with_its_figures_and_its_reason() -> None:
    thin, thick = describe_groups([asdict(THIN), asdict(THICK)])
    assert thin.startswith("optical depth 0.05 to 1.5: single scattering; the orders beyond add 0.4%")
    assert StopReason.SINGLE.value in thin
    assert "0.8 s" in thin
    assert "orders to 66; 6,000,000 paths from 12,345 points 1.2 voxels apart; error 3.1%" in thick
    assert StopReason.PATHS.value in thick
    assert "beyond" not in thick
    assert "carried" not in thick
    (carried,) = describe_groups([asdict(replace(THICK, carried_points=40_000))])
    assert "voxels apart, the high orders carried on 40,000 points; error 3.1%" in carried


def test_stacks_without_cloud_have_nothing_to_say() -> None:
    assert describe_groups(()) == []
