"""The runs of a comparison arranged by problem and method, with the figures of merit of each cell and of each method."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cloudfit.comparison.bootstrap import Contrast, compare_pairs
from cloudfit.comparison.performance import (
    SUCCESS_EXCESS,
    TIME_DECADES,
    anytime_area,
    excess,
    expected_running_time,
    loss_of_excess,
    profile_target,
    quartiles,
    runtimes,
    simplex_gradients,
)
from cloudfit.comparison.run_record import Floats, RunRecord
from cloudfit.optimisers.base import PENALTY
from render.errors import ParameterError

Quartiles = tuple[float, float, float]


@dataclass(frozen=True)
class Merit:
    """Figures of merit of a set of runs; of a method over several problems where it says so.

    Args:
        runs, failed: how many.
        loss: quartiles of the final losses, computed once more after each run; not comparable between problems.
        excess: quartiles of their relative excess over the best loss anyone found.
        success_rate: share of the runs that end within 1 % of it.
        ert_evaluations, ert_seconds: expected running time until then; infinite without a success.
        aocc_evaluations, aocc_seconds: anytime area over the logarithm of evaluations and of seconds, mean of the runs.
        evaluations, seconds, objective_seconds, overhead_seconds: medians over the runs.
    """

    runs: int
    failed: int
    loss: Quartiles
    excess: Quartiles
    success_rate: float
    ert_evaluations: float
    ert_seconds: float
    aocc_evaluations: float
    aocc_seconds: float
    evaluations: float
    seconds: float
    objective_seconds: float
    overhead_seconds: float


@dataclass(frozen=True, eq=False)
class ProblemRuns:
    """All runs on one problem.

    Args:
        facts: of the problem: name, dimension, floor and more.
        runs: by method.
        budget_evaluations, budget_seconds: limits of each run, or None.
    """

    facts: Mapping[str, Any]
    runs: Mapping[str, Sequence[RunRecord]]
    budget_evaluations: int | None
    budget_seconds: float | None

    @cached_property
    def every(self) -> list[RunRecord]:
        """The runs of all methods."""
        return [run for runs in self.runs.values() for run in runs]

    @cached_property
    def winner(self) -> RunRecord:
        """The run with the best loss that anyone found."""
        return min(self.every, key=lambda run: run.loss)

    @property
    def best(self) -> float:
        """Its loss f*."""
        return self.winner.loss

    @property
    def floor(self) -> float:
        """Loss below which nothing can be told apart."""
        return float(self.facts["floor"])

    @cached_property
    def evaluations_horizon(self) -> float:
        """End of the anytime area over evaluations: the budget, or without one the longest run."""
        longest = self.budget_evaluations or max(run.evaluations for run in self.every)
        return max(2.0, float(longest))

    @cached_property
    def seconds_horizon(self) -> float:
        """End of the anytime area over seconds: the budget; without one the shortest of the methods' median durations.

        Up to then no method has spent its evaluations, so that all are compared at equal seconds.
        """
        if self.budget_seconds is not None:
            return self.budget_seconds
        medians = [
            float(np.median([r.seconds for r in runs if not r.failed] or [math.inf])) for runs in self.runs.values()
        ]
        shortest = min(medians)
        return shortest if math.isfinite(shortest) and shortest > 0 else 1.0

    def excess(self, method: str) -> Floats:
        """Final excess of each run of a method."""
        return excess(np.array([run.loss for run in self.runs[method]]), self.best, self.floor)

    def runtimes(self, method: str, by_seconds: bool) -> Floats:
        """Times to the targets `(run, target)`."""
        return runtimes(self.runs[method], self.best, self.floor, by_seconds)

    def profile_gradients(self, method: str) -> Floats:
        """Simplex gradients until each run passes the convergence test of the data profiles `(run,)`."""
        known = [run.trace.loss[run.trace.loss < PENALTY] for run in self.every]
        first = np.array([losses[0] for losses in known if len(losses)])
        target = profile_target(first, self.best)
        times = np.array([run.trace.evaluations_until(target) for run in self.runs[method]])
        return simplex_gradients(times, int(self.facts["dimension"]))

    def spent(self, method: str, by_seconds: bool) -> tuple[Floats, list[bool]]:
        """What each run spent until its success or its end, and whether it succeeded."""
        target = float(loss_of_excess(SUCCESS_EXCESS, self.best, self.floor))
        spent, succeeded = [], []
        for run in self.runs[method]:
            until = run.trace.seconds_until(target) if by_seconds else run.trace.evaluations_until(target)
            whole = run.seconds if by_seconds else float(run.evaluations)
            succeeded.append(run.loss <= target)
            spent.append(min(until, whole) if run.loss <= target else whole)
        return np.array(spent), succeeded

    def areas(self, method: str, by_seconds: bool) -> Floats:
        """Anytime area of each run of a method; computed once."""
        if (method, by_seconds) not in self._areas:
            self._areas[method, by_seconds] = self._compute_areas(method, by_seconds)
        return self._areas[method, by_seconds]

    @cached_property
    def _areas(self) -> dict[tuple[str, bool], Floats]:
        return {}

    def _compute_areas(self, method: str, by_seconds: bool) -> Floats:
        end = self.seconds_horizon if by_seconds else self.evaluations_horizon
        begin = end / 10.0**TIME_DECADES if by_seconds else 1.0
        return np.array(
            [
                anytime_area(
                    run.trace,
                    run.trace.seconds if by_seconds else run.trace.evaluation,
                    begin,
                    end,
                    self.best,
                    self.floor,
                )
                for run in self.runs[method]
            ]
        )


@dataclass(frozen=True, eq=False)
class Analysis:
    """A comparison.

    Args:
        problems: by name, in order; those on which nobody found anything are left out.
        methods: names, in order; those that evaluated nothing anywhere are left out.
    """

    problems: Mapping[str, ProblemRuns]
    methods: tuple[str, ...]

    @classmethod
    def of_runs(
        cls,
        runs: Sequence[RunRecord],
        facts: Sequence[Mapping[str, Any]],
        methods: Sequence[str],
        budget_evaluations: int | None,
        budget_seconds: float | None,
    ) -> "Analysis":
        """Arrange runs.

        Args:
            runs: finished ones.
            facts: of the problems.
            methods: names in the order wanted; those whose runs evaluated nothing are left out.
            budget_evaluations, budget_seconds: limits of each run.

        Raises:
            ParameterError: no run has found anything.
        """
        problems = {}
        able = [name for name in methods if any(run.evaluations for run in runs if run.method == name)]
        for fact in facts:
            mine = [run for run in runs if run.problem == fact["name"] and run.method in able]
            by_method = {name: [run for run in mine if run.method == name] for name in able}
            filled = {name: found for name, found in by_method.items() if found}
            if any(math.isfinite(run.loss) for run in mine):
                problems[fact["name"]] = ProblemRuns(fact, filled, budget_evaluations, budget_seconds)
        if not problems:
            raise ParameterError("there is no run with a loss to be compared")
        present = tuple(name for name in able if any(name in problem.runs for problem in problems.values()))
        return cls(problems, present)

    def cells(self) -> list[tuple[str, str, Merit]]:
        """Figures of merit for each problem and method."""
        return [
            (name, method, self.merit(method, [problem]))
            for name, problem in self.problems.items()
            for method in problem.runs
        ]

    def merit(self, method: str, problems: Sequence[ProblemRuns] | None = None) -> Merit:
        """Figures of merit of a method over some problems, or all: areas are means over problems, the rest pools the runs."""
        over = [problem for problem in problems or self.problems.values() if method in problem.runs]
        runs = [run for problem in over for run in problem.runs[method]]
        excesses = np.concatenate([problem.excess(method) for problem in over])
        expected, rates = [], []
        for by_seconds in (False, True):
            pairs = [problem.spent(method, by_seconds) for problem in over]
            succeeded = [flag for _, flags in pairs for flag in flags]
            expected.append(expected_running_time(np.concatenate([spent for spent, _ in pairs]), succeeded))
            rates.append(float(np.mean(succeeded)))
        areas = [float(np.mean([p.areas(method, by_seconds).mean() for p in over])) for by_seconds in (False, True)]
        times = [(r.evaluations, r.seconds, r.objective_seconds, r.overhead_seconds) for r in runs]
        medians = np.median(np.array(times, float), axis=0).tolist()
        return Merit(
            len(runs),
            sum(run.failed for run in runs),
            _finite_quartiles([run.loss for run in runs]),
            _finite_quartiles(excesses),
            rates[0],
            *expected,
            *areas,
            *medians,
        )

    def contrasts(self, by_seconds: bool) -> list[Contrast]:
        """All pairs of methods by their anytime area, on the problems that all methods have in common."""
        common = [problem for problem in self.problems.values() if set(self.methods) <= set(problem.runs)]
        if not common:
            return []
        means = {
            method: np.array([problem.areas(method, by_seconds).mean() for problem in common])
            for method in self.methods
        }
        return compare_pairs(means)

    def ranking(self, by_seconds: bool = False) -> list[str]:
        """Methods by their mean anytime area, the best first."""
        areas = {
            method: np.mean([p.areas(method, by_seconds).mean() for p in self.problems.values() if method in p.runs])
            for method in self.methods
        }
        return sorted(self.methods, key=lambda method: -areas[method])

    def pooled_runtimes(self, method: str, by_seconds: bool) -> Floats:
        """Times to the targets of all runs of a method on all problems."""
        tables = [p.runtimes(method, by_seconds) for p in self.problems.values() if method in p.runs]
        return np.concatenate([table.ravel() for table in tables])

    def pooled_gradients(self, method: str) -> Floats:
        """Simplex gradients until convergence of all runs of a method on all problems."""
        return np.concatenate([p.profile_gradients(method) for p in self.problems.values() if method in p.runs])

    def extreme_runs(self, method: str) -> tuple[RunRecord, RunRecord] | None:
        """The runs of a method with the smallest and the largest excess, over all problems; None if it found nothing."""
        placed = [
            (float(value), number, run)
            for problem in self.problems.values()
            if method in problem.runs
            for number, (value, run) in enumerate(zip(problem.excess(method), problem.runs[method], strict=True))
            if math.isfinite(run.loss)
        ]
        if not placed:
            return None
        return min(placed, key=lambda row: row[0])[2], max(placed, key=lambda row: row[0])[2]


def _finite_quartiles(values: Sequence[float] | Floats) -> Quartiles:
    """Quartiles in which a run that found nothing is worse than all others, whatever lies between them."""
    ordered = np.asarray(values, dtype=float)
    if np.all(np.isfinite(ordered)):
        return quartiles(ordered)
    low, median, high = (float(np.quantile(ordered, share, method="higher")) for share in (0.25, 0.5, 0.75))
    return low, median, high
