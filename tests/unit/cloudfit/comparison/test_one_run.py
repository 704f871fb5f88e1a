from collections.abc import Callable
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from cloudfit.comparison.one_run import SEED_STRIDE, Task, TimedObjective, perform
from cloudfit.optimisers import OPTIMISERS, Budget
from cloudfit.optimisers.base import (
    EvaluationLog,
    Minimiser,
    Objective,
    OptimiserResult,
    Progress,
    StopReason,
    run_logged,
)
from render.errors import ParameterError
from tests.support.comparison import bowl_problem


@dataclass(frozen=True)
class Scripted:
    """Evaluates four points that its seed shifts, then does what it was told."""

    ending: Callable[[], StopReason]
    seeds: list[int]

    def minimise(
        self,
        objective: Objective,
        dimension: int,
        budget: Budget,
        seed: int,
        on_progress: Progress | None = None,
        start: Tensor | None = None,
    ) -> OptimiserResult:
        self.seeds.append(seed)

        def search(log: EvaluationLog) -> StopReason:
            log.evaluate(torch.linspace(0.9, 0.5, 4)[:, None].expand(4, dimension) - 0.05 * len(self.seeds))
            return self.ending()

        return run_logged(search, objective, dimension, budget, on_progress)


def task(minimiser: Minimiser, evaluations: int = 10, restarts: bool = True) -> Task:
    return Task("method", minimiser, 7, Budget(evaluations), restarts, "print")


def test_a_run_is_recorded_with_its_trace_and_scored_again() -> None:
    seen = []
    record = perform(
        bowl_problem(), task(OPTIMISERS["genetic"], 60), lambda iteration, evaluation, loss: seen.append(evaluation)
    )
    assert (record.problem, record.method, record.seed, record.failed) == ("bowl", "method", 7, False)
    assert record.evaluations == seen[-1] == 60
    assert record.loss == pytest.approx(float(record.trace.loss[-1]))
    assert 0.2 <= record.loss < 0.4
    assert record.parameters["x"] == pytest.approx(2.0 * record.best[0])
    assert 0.0 < record.objective_seconds < record.seconds
    assert record.trace.seconds[-1] <= record.seconds


def test_a_method_that_ends_of_itself_is_started_again_until_the_budget_is_spent() -> None:
    method = Scripted(lambda: StopReason.CONVERGED, [])
    record = perform(bowl_problem(), task(method))
    assert (record.starts, record.evaluations) == (3, 10)
    assert method.seeds == [7, 7 + SEED_STRIDE, 7 + 2 * SEED_STRIDE]
    assert record.trace.evaluation.tolist() == [1, 2, 3, 4, 8], "the best of all starts"
    assert perform(bowl_problem(), task(method, restarts=False)).evaluations == 4


@pytest.mark.parametrize("reason", [StopReason.EVALUATIONS, StopReason.SECONDS])
def test_a_method_that_its_budget_ends_is_not_started_again(reason: StopReason) -> None:
    assert perform(bowl_problem(), task(Scripted(lambda: reason, []))).starts == 1


def test_a_target_of_the_methods_own_is_no_end_of_the_run_but_one_of_the_budget_is() -> None:
    method = Scripted(lambda: StopReason.TARGET, [])
    assert perform(bowl_problem(), task(method)).starts == 3
    aimed = Task("method", method, 7, Budget(10, None, 1e-9), True, "print")
    assert perform(bowl_problem(), aimed).starts == 1


def test_a_failure_keeps_what_was_found() -> None:
    def fail() -> StopReason:
        raise ValueError("no more")

    record = perform(bowl_problem(), task(Scripted(fail, [])))
    assert record.failed
    assert "ValueError: no more" in record.message
    assert (record.evaluations, record.starts) == (4, 1)


def test_a_method_that_finds_nothing_leaves_a_failed_run() -> None:
    class Broken:
        def minimise(self, *arguments: object) -> OptimiserResult:
            raise RuntimeError("broken at once")

    record = perform(bowl_problem(), task(Broken()))
    assert (record.failed, record.evaluations, record.loss) == (True, 0, float("inf"))
    assert record.message == "RuntimeError: broken at once"


def test_a_method_that_does_not_take_the_problem_has_refused_it_and_not_failed_later() -> None:
    class Choosy:
        def minimise(self, *arguments: object) -> OptimiserResult:
            raise ParameterError("choose a differentiable loss")

    record = perform(bowl_problem(), task(Choosy()))
    assert (record.failed, record.refused, record.message) == (True, True, "choose a differentiable loss")

    def fail() -> StopReason:
        raise ParameterError("in the middle")

    assert not perform(bowl_problem(), task(Scripted(fail, []))).refused


def test_ctrl_c_leaves_no_run() -> None:
    def stop() -> StopReason:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        perform(bowl_problem(), task(Scripted(stop, [])))


def test_every_batch_is_timed_and_gradients_are_handed_on() -> None:
    class Sloped:
        def __call__(self, population: Tensor) -> Tensor:
            return population.sum(1)

        def with_gradient(self, population: Tensor) -> tuple[Tensor, Tensor]:
            return population.sum(1), torch.ones_like(population)

    timed = TimedObjective(Sloped())
    timed(torch.zeros(2, 3))
    losses, gradient = timed.with_gradient(torch.ones(3, 3))
    assert losses.tolist() == [3.0, 3.0, 3.0]
    assert gradient.shape == (3, 3)
    times = timed.times()
    assert len(times) == 5
    assert 0.0 < times[0] == times[1] < times[2] == times[4]
    assert 0.0 < timed.seconds <= times[4]
    assert not hasattr(TimedObjective(lambda population: population.sum(1)), "with_gradient")
