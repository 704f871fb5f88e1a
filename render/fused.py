"""Fused loops: compiled twins of the few torch loops in which a build spends its time.

Each twin takes the arguments of the torch code beside it, draws the same random numbers and is tested equal to it. The torch code is
complete, and the one to read. The twins need numba (`pip install "cloudfit[fast]"`), are compiled at the first call and kept on disk,
release the interpreter's lock and run in as many threads as torch may use.
"""

import logging
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import torch
from torch import Tensor

SWITCH = "CLOUDFIT_FUSED"
"""Environment variable that turns the fused loops off with 0."""

log = logging.getLogger("cloudfit")

_allowed: ContextVar[bool] = ContextVar("fused loops allowed", default=True)


@cache
def _installed() -> bool:
    return os.environ.get(SWITCH, "1") != "0" and find_spec("numba") is not None and _prepare_cache()


def _prepare_cache() -> bool:
    """Tell numba where to keep what it compiles; false if there is no place to write, for then it refuses to load the loops at all."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return True
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(base) / "cloudfit" / "numba"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return False
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    return os.access(folder, os.W_OK)


def fused_loops_wanted(*tensors: Tensor) -> bool:
    """Whether fused loops are installed, allowed here, and fit these tensors: on the CPU, and nobody asks for gradients."""
    plain = all(tensor.device.type == "cpu" and not tensor.requires_grad for tensor in tensors)
    return plain and _allowed.get() and _installed()


@contextmanager
def torch_loops_only() -> Iterator[None]:
    """Within this block the torch loops are used even where faster twins are installed."""
    token = _allowed.set(False)
    try:
        yield
    finally:
        _allowed.reset(token)


def run_in_threads(work: Callable[[int, int], None], count: int, chunk: int) -> None:
    """Call `work(first, last)` for consecutive chunks of 0..count, in the threads that torch may use.

    Args:
        work: releases the interpreter's lock and writes only what belongs to its chunk.
        count: number of items.
        chunk: items of a call, few enough that the threads end together.
    """
    firsts = range(0, count, chunk)
    threads = min(torch.get_num_threads(), len(firsts))
    if threads <= 1:
        for first in firsts:
            work(first, min(first + chunk, count))
        return
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(lambda first: work(first, min(first + chunk, count)), firsts):
            continue


@cache
def announce_compilation(module: str, folder: str) -> None:
    """Say once that the first call takes longer, where somebody listens to the logger "cloudfit".

    Args:
        module: file name of the fused loops without its ending.
        folder: where numba keeps what it compiles.
    """
    if not any(Path(folder).glob(f"{module}.*.nbi")):
        log.info("compiling the fused loops, once; it takes some ten seconds and is kept on disk")
