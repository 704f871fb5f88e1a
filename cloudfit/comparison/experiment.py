"""An experiment: which methods run on which problems from which seeds; what is finished stays, what is missing is done."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from cloudfit import __version__
from cloudfit.comparison.one_run import Task, perform
from cloudfit.comparison.problems import ProblemSource, load_problem
from cloudfit.comparison.run_record import RunRecord, kept_run, write_run
from cloudfit.optimisers.base import Budget, Minimiser
from precompute.store import table_key
from render.errors import ParameterError

RUNS_NAME = "runs"
"""Folder of the runs inside the output folder."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """What is compared.

    Args:
        problems: with distinct names.
        methods: by name.
        seeds: of the runs of each method on each problem.
        budget: of each run; evaluations or seconds must be limited.
        out: folder of the runs and the reports.
        restarts: whether a method that ends of itself is started again from another seed while budget is left.

    Raises:
        ParameterError: when there is nothing to compare, no limit, or a name twice.
    """

    problems: Sequence[ProblemSource]
    methods: Mapping[str, Minimiser]
    seeds: Sequence[int]
    budget: Budget
    out: Path
    restarts: bool = True

    def __post_init__(self) -> None:
        if not (self.problems and self.methods and self.seeds):
            raise ParameterError(
                f"expected problems, methods and seeds to compare, got {len(self.problems)}, {len(self.methods)} and {len(self.seeds)}"
            )
        if self.budget.evaluations is None and self.budget.seconds is None:
            raise ParameterError("expected a limit of the evaluations or the seconds of a run; some methods never end")
        names = [problem.name for problem in self.problems]
        if len(set(names)) < len(names):
            raise ParameterError(f"expected distinct names of problems, got {', '.join(names)}")

    def tasks(self) -> list["ProblemTask"]:
        """All runs, seed by seed, so that what an interruption leaves is balanced; problem by problem within a seed.

        A method that every seed leads to the same run has one on each problem.
        """
        prints = {problem.name: problem.fingerprint() for problem in self.problems}
        return [
            ProblemTask(problem, self._task(name, seed, prints[problem.name]), self.path(problem.name, name, seed))
            for seed in self.seeds
            for problem in self.problems
            for name, minimiser in self.methods.items()
            if seed == self.seeds[0] or not getattr(minimiser, "is_deterministic", False)
        ]

    def path(self, problem: str, method: str, seed: int) -> Path:
        """File of a run."""
        return self.out / RUNS_NAME / problem / method / f"seed-{seed:04d}.json"

    def _task(self, method: str, seed: int, problem: str) -> Task:
        dependencies = {
            "version": __version__,
            "problem": problem,
            "method": [method, settings_of(self.methods[method])],
            "seed": seed,
            "budget": self.budget,
            "restarts": self.restarts,
        }
        return Task(method, self.methods[method], seed, self.budget, self.restarts, table_key(dependencies))


def settings_of(minimiser: Minimiser) -> str:
    """A method with its settings as text, the same in every process: where objects lie in memory is left out."""
    return re.sub(r" at 0x[0-9a-fA-F]+", "", repr(minimiser))


@dataclass(frozen=True, eq=False)
class ProblemTask:
    """A run to be done: on which problem, and the file that it ends in."""

    problem: ProblemSource
    task: Task
    path: Path

    def describe(self) -> str:
        """The run in words."""
        return f"{self.problem.name}, {self.task.method}, seed {self.task.seed}"


class ExperimentListener(Protocol):
    """Whoever watches an experiment."""

    def planned(self, total: int, kept: int) -> None:
        """Called once: number of runs, and how many of them an earlier call has done."""

    def stage(self, subject: str, share: float) -> None:
        """Called often: which run is under way and the share of its budget that is spent."""

    def finished(self, record: RunRecord) -> None:
        """Called after each run that was done now."""


class SilentListener:
    """Watches without a word."""

    def planned(self, total: int, kept: int) -> None:
        """Ignore the plan."""

    def stage(self, subject: str, share: float) -> None:
        """Ignore the stage."""

    def finished(self, record: RunRecord) -> None:
        """Ignore the run."""


SILENT = SilentListener()


@dataclass(frozen=True)
class ExperimentReport:
    """What became of an experiment.

    Args:
        runs: that are finished, kept ones included.
        kept: how many of them an earlier call had done.
        total: how many there are to be.
        interrupted: whether Ctrl-C ended it.
    """

    runs: tuple[RunRecord, ...]
    kept: int
    total: int
    interrupted: bool

    @property
    def failed(self) -> tuple[RunRecord, ...]:
        """Runs whose method failed, without those that it refused."""
        return tuple(run for run in self.runs if run.failed and not run.refused)

    @property
    def refused(self) -> dict[str, str]:
        """Methods that did not take a problem, and why."""
        return {run.method: run.message for run in self.runs if run.refused}


def conduct(experiment: Experiment, jobs: int = 1, listener: ExperimentListener = SILENT) -> ExperimentReport:
    """Do all runs that no earlier call has done; each is on disk when it ends.

    A run of an earlier call counts if it answers just the same question: problem, method with its settings, seed, budget, version.
    A method that failed is not tried again.

    Args:
        experiment: what is compared.
        jobs: runs at the same time, each in a process of its own with its share of the cores if more than one; with one
            thread each their seconds are those of the processor.
        listener: is told what happens.

    Returns:
        The runs. After Ctrl-C, those that were finished: the ones under way are lost.

    Raises:
        ParameterError: for less than one job.
        CloudfitError: a problem cannot be loaded.
    """
    if jobs < 1:
        raise ParameterError(f"expected at least one job, got {jobs}")
    tasks = experiment.tasks()
    done = {id(task): run for task in tasks if (run := kept_run(task.path, task.task.fingerprint)) is not None}
    missing = [task for task in tasks if id(task) not in done]
    kept = len(done)
    listener.planned(len(tasks), kept)
    interrupted = False
    try:
        for task, record in _do(missing, min(jobs, len(missing)), listener):
            done[id(task)] = record
            listener.finished(record)
    except KeyboardInterrupt:
        interrupted = True
    return ExperimentReport(tuple(done[id(t)] for t in tasks if id(t) in done), kept, len(tasks), interrupted)


def _do(
    tasks: Sequence[ProblemTask], jobs: int, listener: ExperimentListener
) -> Iterator[tuple[ProblemTask, RunRecord]]:
    if jobs > 1:
        from cloudfit.comparison.workers import perform_in_workers

        for source in {task.problem.name: task.problem for task in tasks}.values():
            listener.stage(f"preparing {source.name}", 0.0)
            load_problem(source)  # builds its stack once, and says what is wrong before any process begins
        yield from perform_in_workers(tasks, jobs)
        return
    for task in tasks:
        yield task, perform_and_write(task, listener)


def perform_and_write(task: ProblemTask, listener: ExperimentListener = SILENT) -> RunRecord:
    """Do one run and write it."""
    subject = task.describe()
    listener.stage(subject, 0.0)
    problem = load_problem(task.problem)
    largest = task.task.budget.evaluations

    def report(iterations: int, evaluations: int, best_loss: float) -> None:
        share = 0.0 if largest is None else min(1.0, evaluations / largest)
        listener.stage(f"{subject}: loss {best_loss:.3f}", share)

    record = perform(problem, task.task, report)
    write_run(task.path, record)
    return record
