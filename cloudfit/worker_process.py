"""How worker processes begin and end."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Collection
from concurrent.futures import Future, ProcessPoolExecutor
from typing import Any

import cv2
import torch


def begin_worker(threads: int) -> None:
    """Take a share of the cores, leave Ctrl-C to the parent, and end with it.

    Ctrl-C reaches the whole group of processes, and the parent alone answers it. A parent that is killed tells nobody: its workers
    would go on.

    Args:
        threads: of this process.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def end_pool(pool: ProcessPoolExecutor, futures: Collection[Future[Any]]) -> None:
    """End the processes of a pool without waiting for what they are at.

    Args:
        pool: that is not used again.
        futures: all that it was given.
    """
    if not all(future.done() for future in futures):
        for process in list((pool._processes or {}).values()):
            process.terminate()
    # Waiting matters: the interpreter's end would stumble over pipes that the pool is closing.
    pool.shutdown(wait=True, cancel_futures=True)
