"""A folder of photographs: fit each, keep what is finished, survive what is not."""

import os
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import torch

from cloudfit.fit_types import FitOptions
from cloudfit.one_photograph import (
    ALL_STAGES,
    Job,
    Outcome,
    StackSource,
    StackUnavailableError,
    Stages,
    ask,
    kept_outcome,
    treat_photograph,
)
from cloudfit.report import write_folder_page
from cloudfit.result import Question
from cloudfit.result_folder import folder_names, remove_temporary_folders
from cloudfit.scene import Scene
from cloudfit.worker_pool import treat_in_workers
from precompute.stack_store import StackReport
from render.errors import CloudfitError, InputError, ParameterError

TABLES_NAME = ".tables"
"""Folder of the stack files inside the output folder, unless another one is given."""


class BatchListener(Protocol):
    """Whoever watches a batch."""

    def planned(self, total: int, kept: int) -> None:
        """Called once: number of photographs, and how many of them an earlier run has done."""

    def stage(self, subject: str, stage: str, share: float) -> None:
        """Called often: what is worked on and the share of this stage that is done."""

    def finished(self, outcome: Outcome) -> None:
        """Called after each photograph, kept ones included."""


class SilentListener:
    """Watches without a word."""

    def planned(self, total: int, kept: int) -> None:
        """Ignore the plan."""

    def stage(self, subject: str, stage: str, share: float) -> None:
        """Ignore the stage."""

    def finished(self, outcome: Outcome) -> None:
        """Ignore the outcome."""


SILENT = SilentListener()


@dataclass(frozen=True)
class BatchSettings:
    """How a batch is run.

    Args:
        out: folder of the results, made if needed.
        tables: folder of the stack files; None for one inside `out`.
        force: fit again what an earlier run has done.
        jobs: photographs treated at the same time, each in a process of its own if more than one.
    """

    out: Path
    tables: Path | None = None
    force: bool = False
    jobs: int = 1


@dataclass(frozen=True)
class BatchReport:
    """What became of a batch.

    Args:
        outcomes: of the photographs that were treated or kept, in the order given.
        page: of the whole folder.
        stack: where the stack came from; None if it was not needed, or only workers needed it.
        interrupted: whether Ctrl-C ended it.
    """

    outcomes: tuple[Outcome, ...]
    page: Path
    stack: StackReport | None
    interrupted: bool

    def count(self, status: str) -> int:
        """Number of photographs with a status."""
        return sum(outcome.status == status for outcome in self.outcomes)

    @property
    def did_nothing(self) -> bool:
        """Whether an earlier run had done everything."""
        return bool(self.outcomes) and all(outcome.kept for outcome in self.outcomes)


def fit_folder(
    photographs: Sequence[Path],
    scene: Scene,
    options: FitOptions,
    settings: BatchSettings,
    masks: Mapping[Path, Path] | None = None,
    listener: BatchListener = SILENT,
    stages: Stages = ALL_STAGES,
) -> BatchReport:
    """Fit the same scene to each of several photographs.

    A photograph that cannot be fitted gets a result with the reason, and the others go on. What an earlier run has
    answered, for the same photograph, mask, scene, options and version, is kept.

    Args:
        photographs: files.
        scene: volume, camera and sun.
        options: of the fits.
        settings: of the batch.
        masks: masks of the user by photograph.
        listener: is told what happens.
        stages: the steps of a fit.

    Returns:
        What became of each. After Ctrl-C, of those that were finished.

    Raises:
        InputError: the output folder cannot be made, or a number is out of its domain.
        CloudfitError: the stack can be neither loaded nor built.
    """
    if settings.jobs < 1:
        raise ParameterError(f"expected at least one job, got {settings.jobs}")
    _make_folder(settings.out)
    token = secrets.token_hex(6)
    names = folder_names(list(photographs))
    jobs = [Job(path, (masks or {}).get(path), settings.out / names[path]) for path in photographs]
    questions = {job: ask(job, scene, options) for job in jobs}
    outcomes: dict[Job, Outcome] = {}
    if not settings.force:
        outcomes = {job: kept for job in jobs if (kept := kept_outcome(job, questions[job])) is not None}
    listener.planned(len(jobs), len(outcomes))
    for outcome in outcomes.values():
        listener.finished(outcome)
    open_questions = {job: questions[job] for job in jobs if job not in outcomes}
    tables = settings.tables if settings.tables is not None else settings.out / TABLES_NAME
    source = StackSource(scene, options, tables, stages)
    interrupted = False
    try:
        workers = min(settings.jobs, len(open_questions))
        treat = _treat_here if workers <= 1 else _treat_in_workers
        interrupted = treat(open_questions, source, token, workers, listener, outcomes)
    except KeyboardInterrupt:
        interrupted = True
    except StackUnavailableError as error:
        raise _cause(error) from error
    finally:
        remove_temporary_folders(settings.out, token)
    page = write_folder_page(settings.out)
    return BatchReport(tuple(outcomes[job] for job in jobs if job in outcomes), page, source.report, interrupted)


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def limit_threads(threads: int) -> None:
    """Use at most so many threads from here on; a smaller limit from the environment stays."""
    threads = max(1, min(threads, torch.get_num_threads()))
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)


def _treat_here(
    questions: Mapping[Job, Question],
    source: StackSource,
    token: str,
    workers: int,
    listener: BatchListener,
    outcomes: dict[Job, Outcome],
) -> bool:
    """Treat the photographs one after the other; returns whether Ctrl-C ended a search."""
    for job, question in questions.items():

        def report(stage: str, share: float, name: str = job.photograph.name) -> None:
            listener.stage(name, stage, share)

        outcomes[job] = treat_photograph(job, question, source, token, report)
        listener.finished(outcomes[job])
        if outcomes[job].interrupted:
            return True
    return False


def _treat_in_workers(
    questions: Mapping[Job, Question],
    source: StackSource,
    token: str,
    workers: int,
    listener: BatchListener,
    outcomes: dict[Job, Outcome],
) -> bool:
    """Build the stack, then treat the photographs in processes that load it; returns False."""
    source.get(lambda stage, share: listener.stage("scattering stack", stage, share))
    threads = max(1, available_cores() // workers)
    for outcome in treat_in_workers(list(questions), source, token, workers, threads):
        outcomes[outcome.job] = outcome
        listener.finished(outcome)
    return False


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the output folder {out}: {error.strerror or error}") from error


def _cause(error: StackUnavailableError) -> CloudfitError:
    cause = error.__cause__
    return cause if isinstance(cause, CloudfitError) else InputError(f"cannot keep the scattering stack: {cause}")
