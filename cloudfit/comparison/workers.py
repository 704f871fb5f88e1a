"""Runs in several processes; a method that takes its process down loses its own run alone, and the experiment goes on."""

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import torch

from cloudfit.batch import available_cores
from cloudfit.comparison.experiment import ProblemTask, perform_and_write
from cloudfit.comparison.run_record import Floats, RunRecord, Trace, read_run, write_run
from cloudfit.worker_process import begin_worker, end_pool

DIED = "the process of the run died"


def perform_in_workers(tasks: Sequence[ProblemTask], workers: int) -> Iterator[tuple[ProblemTask, RunRecord]]:
    """Do runs in processes of their own, each with its share of the cores.

    Args:
        tasks: the runs; their stacks should be on disk.
        workers: number of processes.

    Yields:
        Runs in the order in which they end, with their tasks. Leaving the loop ends the processes.

    Raises:
        Exception: what loading a problem raises.
    """
    threads = max(1, available_cores() // workers)
    rest = list(tasks)
    while rest:
        for task in _run_pool(rest, workers, threads):
            rest.remove(task)
            yield task, read_run(task.path)
        # If any is left, a process has died. Work starts in the order given, so it was one of the first: each of those gets a process
        # of its own, and the rest go on together.
        for task in rest[:workers]:
            alone = list(_run_pool([task], 1, threads))
            rest.remove(task)
            yield task, read_run(task.path) if alone else _died(task, threads)


def _run_pool(tasks: Sequence[ProblemTask], workers: int, threads: int) -> Iterator[ProblemTask]:
    """Runs that ended before a process died."""
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), begin_worker, (threads,))
    futures: dict[Future[Path], ProblemTask] = {pool.submit(_perform, task): task for task in tasks}
    try:
        for future in as_completed(futures):
            try:
                future.result()
            except BrokenProcessPool:
                continue
            yield futures[future]
    finally:
        end_pool(pool, futures)


def _perform(task: ProblemTask) -> Path:
    perform_and_write(task)
    return task.path


def _died(task: ProblemTask, threads: int) -> RunRecord:
    """Write down a run that took its process with it."""
    nothing: Floats = torch.empty(0, dtype=torch.float64).numpy()
    record = RunRecord(
        fingerprint=task.task.fingerprint,
        problem=task.problem.name,
        method=task.task.method,
        seed=task.task.seed,
        failed=True,
        message=DIED,
        starts=1,
        evaluations=0,
        seconds=0.0,
        objective_seconds=0.0,
        best=(),
        parameters={},
        loss=float("inf"),
        threads=threads,
        trace=Trace(nothing, nothing, nothing),
    )
    write_run(task.path, record)
    return record
