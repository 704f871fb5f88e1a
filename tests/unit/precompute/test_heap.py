"""Freed memory goes back to the system."""

import ctypes
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from precompute import heap
from precompute.heap import trim_heap

BLOCK, BLOCKS = 64 << 10, 2000


def resident() -> int:
    """Bytes of this process in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux says what a process has in /proc")
def test_what_is_free_below_a_block_that_stays_is_given_back() -> None:
    library = ctypes.CDLL(None)
    if not hasattr(library, "malloc_trim"):
        pytest.skip("not glibc")
    library.malloc.restype, library.free.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
    blocks = [library.malloc(BLOCK) for _ in range(BLOCKS)]
    for block in blocks:
        ctypes.memset(block, 1, BLOCK)
    for block in blocks[:-1]:
        library.free(block)
    before = resident()
    trim_heap()
    after = resident()
    library.free(blocks[-1])
    assert before - after > 0.5 * BLOCK * BLOCKS


@pytest.mark.parametrize("library", [None, SimpleNamespace()])
def test_systems_without_it_are_left_alone(library: object, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    monkeypatch.setattr(heap, "_c_library", lambda: SimpleNamespace(malloc_trim=calls.append))
    trim_heap()
    monkeypatch.setattr(heap, "_c_library", lambda: library)
    trim_heap()
    assert calls == [0]
