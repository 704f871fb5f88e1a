"""Photographs in several processes; a process that dies takes one photograph with it, not the batch."""

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

import torch
from numpy.typing import NDArray

from cloudfit.fit_types import FitOptions
from cloudfit.one_photograph import (
    Job,
    Outcome,
    StackSource,
    StackUnavailableError,
    Stages,
    ask,
    record_reason,
    treat_photograph,
)
from cloudfit.scene import Scene
from cloudfit.worker_process import begin_worker, end_pool
from render.camera import Camera
from render.density_grid import DensityGrid
from render.errors import InputError

DIED = "the process that treated it died, perhaps for want of memory; try fewer --jobs or a smaller camera"


@dataclass(frozen=True)
class _Packet:
    """What a worker needs, as plain arrays: tensors would travel through shared memory, which containers are short of."""

    density: NDArray
    lower: NDArray
    upper: NDArray
    volume: Path | None
    camera: Camera
    sun: tuple[float, float]
    options: FitOptions
    tables: Path | None
    stages: Stages
    token: str
    threads: int

    def unpack(self) -> StackSource:
        grid = DensityGrid(*(torch.from_numpy(array) for array in (self.density, self.lower, self.upper)))
        return StackSource(Scene(grid, self.volume, self.camera, *self.sun), self.options, self.tables, self.stages)


@dataclass(frozen=True)
class _Worker:
    source: StackSource
    token: str


_worker: _Worker | None = None


def treat_in_workers(
    jobs: Sequence[Job], source: StackSource, token: str, workers: int, threads: int
) -> Iterator[Outcome]:
    """Treat photographs in processes of their own; their stack is loaded from the file that the caller built.

    Args:
        jobs: photographs.
        source: of the stack.
        token: marks temporary folders.
        workers: number of processes.
        threads: of each process.

    Yields:
        Outcomes in the order in which they are finished. Leaving the loop ends the processes.
    """
    packet = _pack(source, token, threads)
    rest = list(jobs)
    while rest:
        for outcome in _run_pool(rest, packet, workers):
            rest.remove(outcome.job)
            yield outcome
        # A process has died if any is left. Whose fault it was is not told, but work starts in the order given: it was one of
        # the first. Each of those gets a process of its own, and the rest go on together.
        for job in rest[:workers]:
            alone = list(_run_pool([job], packet, 1))
            rest.remove(job)
            if alone:
                yield alone[0]
            else:
                yield record_reason(job, ask(job, source.scene, source.options), ("failed", DIED), token)


def _run_pool(jobs: Sequence[Job], packet: "_Packet", workers: int) -> Iterator[Outcome]:
    """Outcomes of the jobs that were finished before a process died."""
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _start, (packet,))
    futures = [pool.submit(_treat, job) for job in jobs]
    try:
        for future in as_completed(futures):
            try:
                yield future.result()
            except BrokenProcessPool:
                continue
    finally:
        end_pool(pool, futures)


def _pack(source: StackSource, token: str, threads: int) -> _Packet:
    scene = source.scene
    density, lower, upper = (t.cpu().numpy() for t in (scene.grid.density, scene.grid.lower, scene.grid.upper))
    sun = (scene.sun_azimuth, scene.sun_elevation)
    return _Packet(
        density,
        lower,
        upper,
        scene.volume,
        scene.camera,
        sun,
        source.options,
        source.tables,
        source.stages,
        token,
        threads,
    )


def _start(packet: _Packet) -> None:
    """First thing in a worker."""
    global _worker
    begin_worker(packet.threads)
    _worker = _Worker(packet.unpack(), packet.token)


def _treat(job: Job) -> Outcome:
    if _worker is None:
        raise RuntimeError("the worker was not started with its packet")
    source = _worker.source
    try:
        return treat_photograph(job, ask(job, source.scene, source.options), source, _worker.token)
    except StackUnavailableError as error:
        raise InputError(str(error)) from error
