"""Giving freed memory back to the system."""

import ctypes
import sys
from functools import cache


@cache
def _c_library() -> ctypes.CDLL | None:
    return ctypes.CDLL(None) if sys.platform.startswith("linux") else None


def trim_heap() -> None:
    """Return what is free in the heaps of all threads, where the C library can (glibc's `malloc_trim`).

    Tensors of some megabytes come from these heaps, and what one step frees between blocks that stay is no place for the next one's
    larger tensors: a build of 100 thousand source points peaked at 2.1 GB without this and at 1.8 GB with it.
    """
    trim = getattr(_c_library(), "malloc_trim", None)
    if trim is not None:
        trim(0)
