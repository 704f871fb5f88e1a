"""Independent pieces of a table in parallel: one thread for each piece, rather than all threads for each small operation."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from typing import TypeVar

import torch

Piece = TypeVar("Piece")


def map_in_threads(
    work: Callable[[int], Piece], count: int, on_done: Callable[[int], None] = lambda finished: None
) -> list[Piece]:
    """Results of `work(0)`, ..., `work(count - 1)`, in the threads that torch may use.

    Args:
        work: spends its time in torch, which releases the interpreter's lock; the pieces do not depend on each other.
        count: of pieces.
        on_done: called with the number of pieces that are finished, from the calling thread, in order.

    Returns:
        The results in their order. They do not depend on the number of threads.
    """
    threads = min(torch.get_num_threads(), count)
    results: list[Piece] = []
    if threads <= 1:
        for number in range(count):
            results.append(work(number))
            on_done(number + 1)
        return results
    with _one_thread_each(), ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(copy_context().run, work, number) for number in range(count)]
        try:
            for number, future in enumerate(futures):
                results.append(future.result())
                on_done(number + 1)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return results


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Threads that begin within this block run their torch operations alone."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
