"""What every worker process does first."""

import multiprocessing
import os
import signal
import threading

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
