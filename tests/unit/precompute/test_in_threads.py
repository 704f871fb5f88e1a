"""Pieces in threads: in order, the same as one after the other, and an error of one is an error of all."""

import threading
import time
from contextvars import ContextVar

import pytest
import torch

from precompute.in_threads import map_in_threads
from render.fused import fused_loops_wanted, torch_loops_only


@pytest.fixture(params=[1, 3])
def threads(request: pytest.FixtureRequest):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def test_results_come_in_order_and_progress_from_the_caller(threads: int) -> None:
    told: list[int] = []
    callers: set[int] = set()

    def note(done: int) -> None:
        told.append(done)
        callers.add(threading.get_ident())

    assert map_in_threads(lambda number: number * number, 7, note) == [0, 1, 4, 9, 16, 25, 36]
    assert told == [1, 2, 3, 4, 5, 6, 7]
    assert callers == {threading.get_ident()}
    assert torch.get_num_threads() == threads


def test_each_piece_has_one_thread_of_torch(threads: int) -> None:
    assert set(map_in_threads(lambda number: torch.get_num_threads(), 6)) == {1}


def test_an_error_ends_the_rest(threads: int) -> None:
    begun: list[int] = []

    def fail(number: int) -> None:
        begun.append(number)
        if number == 0:
            raise ZeroDivisionError
        time.sleep(0.005)  # or all might have begun before the calling thread hears of it

    with pytest.raises(ZeroDivisionError):
        map_in_threads(fail, 1000)
    assert len(begun) < 1000
    assert torch.get_num_threads() == threads


shade: ContextVar[str] = ContextVar("shade", default="white")


def test_the_calling_context_reaches_every_piece(threads: int) -> None:
    token = shade.set("grey")
    try:
        assert map_in_threads(lambda number: shade.get(), 5) == ["grey"] * 5
    finally:
        shade.reset(token)
    assert map_in_threads(lambda number: shade.get(), 5) == ["white"] * 5


def test_torch_loops_alone_are_used_by_every_piece(threads: int) -> None:
    with torch_loops_only():
        assert map_in_threads(lambda number: fused_loops_wanted(), 5) == [False] * 5
    assert map_in_threads(lambda number: fused_loops_wanted(), 5) == [fused_loops_wanted()] * 5


def test_pieces_keep_the_context_that_they_change_from_the_caller() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        map_in_threads(lambda number: shade.set("black"), 5)
    finally:
        torch.set_num_threads(before)
    assert shade.get() == "white"
