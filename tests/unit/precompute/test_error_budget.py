"""What an effort allows, and what follows a pass."""

import dataclasses
import math

import pytest
import torch

from precompute.error_budget import (
    FIRST_SHARE,
    LEAST_GROWTH,
    MET_SHARE,
    MOST_GROWTH,
    Effort,
    StopReason,
    box_error,
    next_pass,
)
from render.errors import ParameterError

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


def test_a_rest_too_small_for_a_pass_is_spent_with_the_one_before() -> None:
    """300 thousand would follow 500 thousand after the 200 thousand so far, and a pass adds half of what there is."""
    assert following(done=200_000, error=0.05 * math.sqrt(3.5)) == 800_000


def test_the_time_may_be_up() -> None:
    assert following(max_seconds=100.0) == 300_000
    assert following(max_seconds=3.0) == pytest.approx(200_000, abs=1)
    assert following(max_seconds=1.4) is StopReason.SECONDS
    assert following(seconds=5.0, max_seconds=3.0) is StopReason.SECONDS


def test_every_reason_is_a_sentence_of_its_own() -> None:
    assert len({reason.value for reason in StopReason}) == len(StopReason) == 5


def test_eleven_of_twelve_do_not_exceed_the_error_of_a_box() -> None:
    errors = torch.rand(5, 7, 100, generator=torch.Generator().manual_seed(0))
    assert float((errors <= box_error(errors)).double().mean()) == pytest.approx(MET_SHARE, abs=1e-3)
    worst = torch.zeros(12)
    worst[-1] = 9.0
    assert box_error(torch.cat([worst, torch.zeros(1)])) == 0.0
    assert box_error(torch.full((24,), 0.3)) == pytest.approx(0.3)
    assert box_error(torch.empty(0, 4)) == 0.0
