"""Pieces in threads: in order, the same as one after the other, and an error of one is an error of all."""

import threading

import pytest
import torch

from precompute.in_threads import map_in_threads


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
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        map_in_threads(fail, 1000)
    assert len(begun) < 1000
    assert torch.get_num_threads() == threads
