"""When fused loops are used, and that their threads do each piece of work once."""

import os
import subprocess
import sys
import threading
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch

from render.fused import SWITCH, fused_loops_wanted, run_in_threads, torch_loops_only
from render.trilinear import TrilinearTable

NUMBA = find_spec("numba") is not None
USED = NUMBA and os.environ.get(SWITCH, "1") != "0"
ROOT = Path(__file__).resolve().parents[3]
PLAIN = torch.zeros(3)

needs_numba = pytest.mark.skipif(not USED, reason="numba is not installed, or not to be used")


@needs_numba
def test_plain_tensors_are_looked_up_by_fused_loops() -> None:
    assert fused_loops_wanted()
    assert fused_loops_wanted(PLAIN, PLAIN)


def test_gradients_and_other_devices_need_torch() -> None:
    assert not fused_loops_wanted(PLAIN, torch.zeros(3, requires_grad=True))
    assert not fused_loops_wanted(PLAIN, torch.zeros(3, device="meta"))


def test_a_block_can_refuse_them_and_ends_even_by_an_error() -> None:
    before = fused_loops_wanted(PLAIN)
    with torch_loops_only():
        assert not fused_loops_wanted(PLAIN)
        with torch_loops_only():
            assert not fused_loops_wanted(PLAIN)
        assert not fused_loops_wanted(PLAIN)
    assert fused_loops_wanted(PLAIN) is before is USED
    with pytest.raises(ZeroDivisionError), torch_loops_only():
        raise ZeroDivisionError
    assert fused_loops_wanted(PLAIN) is before


@pytest.mark.parametrize(("value", "expected"), [("0", False), ("1", NUMBA), (None, NUMBA)])
def test_the_environment_turns_them_off(value: str | None, expected: bool) -> None:
    environment = {name: text for name, text in os.environ.items() if name != SWITCH}
    if value is not None:
        environment[SWITCH] = value
    command = "from render.fused import fused_loops_wanted; print(fused_loops_wanted())"
    run = subprocess.run(
        [sys.executable, "-c", command], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == str(expected)


@pytest.mark.parametrize("writable", [True, False])
def test_loops_need_a_place_for_what_is_compiled(writable: bool, tmp_path: Path) -> None:
    place = tmp_path / "cache"
    if not writable:
        place.write_text("a file, in which no folder can be made")
    environment = {name: value for name, value in os.environ.items() if name not in (SWITCH, "NUMBA_CACHE_DIR")}
    environment["XDG_CACHE_HOME"] = str(place)
    command = "from render.fused import fused_loops_wanted; print(fused_loops_wanted())"
    run = subprocess.run(
        [sys.executable, "-c", command], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == str(writable and NUMBA)
    assert not writable or not NUMBA or (place / "cloudfit" / "numba").is_dir()


def test_without_numba_nothing_asks_for_it() -> None:
    """A stack is built without numba, as if it could not be imported."""
    command = """
import sys
sys.modules["numba"] = None
import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == "numba" else found(name, *rest)
import torch
from precompute.error_budget import Effort
from precompute.scattering_orders import build_scattering_stack
from tests.support.volumes import noise_box, towards, view_north
nodes = torch.tensor([0.0, 0.6]), torch.tensor([1.0])
tables = build_scattering_stack(noise_box(), view_north(4, 3, 7.0), towards(120.0, 30.0), *nodes, Effort(3, 50, 500, 4))
print(bool(tables.multiple.sum() > 0), sum(name.startswith("numba.") for name in sys.modules))
"""
    run = subprocess.run([sys.executable, "-c", command], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["True", "0"]


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the fused look-ups."""
    if not USED:
        pytest.skip("numba is not installed, or not to be used")
    from render import fused_trilinear

    made: list[int] = []
    look_up = fused_trilinear.look_up_trilinear

    def noted(*arguments: torch.Tensor) -> torch.Tensor:
        made.append(len(arguments[1]))
        return look_up(*arguments)

    monkeypatch.setattr(fused_trilinear, "look_up_trilinear", noted)
    return made


def test_look_ups_use_them_for_single_precision_without_gradients_only(calls: list[int]) -> None:
    table = TrilinearTable(torch.rand(3, 4, 5))
    at = torch.rand(3, 7)
    found = table.look_up(*at)
    assert calls == [7]
    with torch_loops_only():
        torch.testing.assert_close(table.look_up(*at), found)
    double = TrilinearTable(table.values.double()).look_up(*at.double())
    torch.testing.assert_close(double.float(), found)
    moving = at.clone().requires_grad_()
    table.look_up(*moving).sum().backward()
    assert moving.grad is not None
    assert bool(moving.grad.any())
    values = table.values.clone().requires_grad_()
    TrilinearTable(values).look_up(*at).sum().backward()
    assert values.grad is not None
    assert float(values.grad.sum()) == pytest.approx(7.0)
    assert calls == [7]


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize(("count", "chunk"), [(0, 4), (1, 4), (4, 4), (10, 4), (1000, 7), (5, 1 << 20)])
def test_every_item_is_done_once(threads: int, count: int, chunk: int) -> None:
    done = torch.zeros(count, dtype=torch.int32)
    spans: list[tuple[int, int]] = []

    def work(first: int, last: int) -> None:
        done[first:last] += 1
        spans.append((first, last))

    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        run_in_threads(work, count, chunk)
    finally:
        torch.set_num_threads(before)
    assert (done == 1).all()
    assert all(0 <= first < last <= count and last - first <= chunk for first, last in spans)


def test_threads_work_beside_each_other_and_their_errors_arrive() -> None:
    meeting = threading.Barrier(2, timeout=10.0)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        run_in_threads(lambda first, last: meeting.wait() and None, 2, 1)
        with pytest.raises(ZeroDivisionError):
            run_in_threads(lambda first, last: 1 // first and None, 2, 1)
    finally:
        torch.set_num_threads(before)
