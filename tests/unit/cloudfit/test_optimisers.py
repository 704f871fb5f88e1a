"""The contract that every registered optimiser keeps."""

import math
import time
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers import OPTIMISERS, Budget, OptimiserResult, StopReason
from cloudfit.optimisers.base import PENALTY
from render.errors import ParameterError

NAMES = tuple(OPTIMISERS)
DRAW_NOTHING = ("direct", "direct_l", "orig_direct_l", "ags")
CONVERGE_EARLY = ("bobyqa", "cobyla", "steepest_descent", "lbfgs")
FOLLOW_THE_GRADIENT = ("adam", "lbfgs")
LOOK_AROUND_FIRST = tuple(name for name in NAMES if name.endswith("_multistart"))
USE_A_START = (
    *("genetic", "genetic_paper", "genetic+sbplx", "sbplx", "bobyqa", "cobyla", "nelder_mead", "mlsl+bobyqa"),
    *("steepest_descent", *FOLLOW_THE_GRADIENT, *LOOK_AROUND_FIRST),
)

LOWEST = 0.6
"""Above 0.5, where the paper's rule would end a run."""


def bowl(population: Tensor) -> Tensor:
    """A quadratic with its minimum at 0.3 in every parameter."""
    return ((population - 0.3) ** 2).sum(dim=1) + LOWEST


class Probe:
    """An objective out of any function, with the slope of the bowl; it keeps what it has answered."""

    def __init__(self, losses: Callable[[Tensor], Tensor] = bowl) -> None:
        self.asked: list[Tensor] = []
        self._losses = losses

    def __call__(self, population: Tensor) -> Tensor:
        losses = self._losses(population)
        self.asked.append(population)
        return losses

    def with_gradient(self, population: Tensor) -> tuple[Tensor, Tensor]:
        return self(population), 2.0 * (population - 0.3)

    @property
    def evaluations(self) -> int:
        return sum(len(population) for population in self.asked)

    def fail_after(self, batches: int, error: BaseException) -> "Probe":
        """The same, but after so many batches this error."""

        def losses(population: Tensor) -> Tensor:
            if len(self.asked) == batches:
                raise error
            return bowl(population)

        self._losses = losses
        return self


def test_the_papers_method_comes_first() -> None:
    assert NAMES[0] == "genetic"
    with pytest.raises(TypeError):
        OPTIMISERS["other"] = OPTIMISERS["genetic"]  # type: ignore[index]


def test_a_polished_search_is_bounded_first() -> None:
    def rough(population: Tensor) -> Tensor:
        return bowl(population) + 0.01 * (1e4 * population).sin().sum(dim=1)

    def run(name: str) -> OptimiserResult:
        return OPTIMISERS[name].minimise(rough, 5, Budget(), seed=1)

    alone, default = run("crs2_lm"), run("crs2_lm+sbplx")
    assert torch.equal(default.evaluated[:1250], alone.evaluated[:1250])
    assert not torch.equal(default.evaluated[1250:1300], alone.evaluated[1250:1300])
    assert default.best_loss < float(alone.losses[:1250].min())
    assert default.evaluations < alone.evaluations


@pytest.mark.parametrize("dimension", [1, 5, 8])
@pytest.mark.parametrize("name", NAMES)
def test_bounds_budget_and_record(name: str, dimension: int) -> None:
    probe, reports = Probe(), []  # type: ignore[var-annotated]
    result = OPTIMISERS[name].minimise(
        probe, dimension, Budget(evaluations=150), seed=1, on_progress=lambda *report: reports.append(report)
    )
    asked = torch.cat(probe.asked)
    assert asked.dtype == torch.float32
    assert asked.shape[1] == dimension
    assert float(asked.min()) >= 0.0
    assert float(asked.max()) <= 1.0
    assert probe.evaluations == result.evaluations <= 150
    if result.stop_reason is StopReason.EVALUATIONS:
        assert result.evaluations == 150
    assert torch.equal(result.evaluated, asked)
    assert result.best_loss == float(result.losses.min()) == float(bowl(result.best[None])[0])
    assert torch.equal(result.best, asked[result.losses.argmin()])
    assert len(result.history) == result.iterations == reports[-1][0]
    assert bool((result.history.diff() <= 0).all())
    assert float(result.history[-1]) == result.best_loss == reports[-1][2]
    assert [report[1] for report in reports] == sorted(report[1] for report in reports)
    assert reports[-1][1] == result.evaluations
    assert result.message == ""
    assert len(result.times) == result.evaluations
    assert bool((result.times.diff() >= 0).all())
    assert 0.0 < result.objective_seconds <= float(result.times[-1]) <= result.seconds


@pytest.mark.parametrize("name", NAMES)
def test_the_minimum_is_approached(name: str) -> None:
    result = OPTIMISERS[name].minimise(Probe(), 2, Budget(evaluations=800), seed=3)
    assert result.best_loss - LOWEST < 2e-3
    torch.testing.assert_close(result.best, torch.full((2,), 0.3), rtol=0, atol=0.05)


@pytest.mark.parametrize("name", NAMES)
def test_same_seed_same_result(name: str) -> None:
    runs = [OPTIMISERS[name].minimise(Probe(), 3, Budget(evaluations=90), seed=seed) for seed in (7, 7, 8)]
    assert torch.equal(runs[0].evaluated, runs[1].evaluated)
    assert torch.equal(runs[0].losses, runs[1].losses)
    # These divide the cube from its centre on.
    if name not in DRAW_NOTHING:
        assert not torch.equal(runs[0].evaluated[:20], runs[2].evaluated[:20])


@pytest.mark.parametrize("name", NAMES)
def test_target_ends_the_run(name: str) -> None:
    free = OPTIMISERS[name].minimise(Probe(), 2, Budget(evaluations=300), seed=2)
    target = 0.5 * float(free.losses[0]) + 0.5 * free.best_loss
    result = OPTIMISERS[name].minimise(Probe(), 2, Budget(evaluations=300, target=target), seed=2)
    assert result.stop_reason is StopReason.TARGET
    assert result.best_loss <= target
    assert result.evaluations < free.evaluations


@pytest.mark.parametrize("name", NAMES)
def test_time_ends_the_run(name: str) -> None:
    def slow(population: Tensor) -> Tensor:
        time.sleep(0.01)
        # Ever better, so that neither stagnation nor convergence ends the run first.
        slow.loss -= 1.0  # type: ignore[attr-defined]
        return torch.full((len(population),), slow.loss)  # type: ignore[attr-defined]

    slow.loss = 1e6  # type: ignore[attr-defined]
    began = time.perf_counter()
    result = OPTIMISERS[name].minimise(Probe(slow), 5, Budget(seconds=0.15), seed=1)
    # Bounded from above by what a crowded machine may add, far from what any method would take by itself.
    assert time.perf_counter() - began < 1.5
    if name not in CONVERGE_EARLY:
        assert result.stop_reason is StopReason.SECONDS
    assert result.evaluations >= 1


@pytest.mark.parametrize("name", NAMES)
def test_interruption_keeps_the_best(name: str) -> None:
    probe = Probe().fail_after(2, KeyboardInterrupt())
    result = OPTIMISERS[name].minimise(probe, 5, Budget(evaluations=500), seed=1)
    assert result.stop_reason is StopReason.INTERRUPTED
    assert len(probe.asked) == result.iterations == 2
    assert result.best_loss == float(bowl(torch.cat(probe.asked)).min())


@pytest.mark.parametrize("name", NAMES)
def test_failure_keeps_the_best_and_the_message(name: str) -> None:
    probe = Probe().fail_after(2, RuntimeError("out of photons"))
    result = OPTIMISERS[name].minimise(probe, 5, Budget(evaluations=500), seed=1)
    assert result.stop_reason is StopReason.FAILED
    assert "out of photons" in result.message
    assert len(probe.asked) == 2
    assert result.best_loss == float(bowl(torch.cat(probe.asked)).min())


@pytest.mark.parametrize("name", NAMES)
def test_failure_of_the_first_evaluation_is_raised(name: str) -> None:
    probe = Probe().fail_after(0, RuntimeError("out of photons"))
    with pytest.raises(RuntimeError, match="out of photons"):
        OPTIMISERS[name].minimise(probe, 5, Budget(evaluations=500), seed=1)


@pytest.mark.parametrize("name", FOLLOW_THE_GRADIENT)
def test_a_gradient_method_asks_for_a_loss_that_has_one(name: str) -> None:
    with pytest.raises(ParameterError, match="choose a differentiable loss"):
        OPTIMISERS[name].minimise(bowl, 5, Budget(evaluations=50), seed=1)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", NAMES)
def test_losses_that_are_not_finite_are_survived(name: str, bad: float) -> None:
    half_bad = Probe(lambda population: torch.where(population[:, 0] > 0.6, bad, bowl(population)))
    result = OPTIMISERS[name].minimise(half_bad, 5, Budget(evaluations=300), seed=1, start=torch.full((5,), 0.5))
    assert result.best_loss < LOWEST + 0.2
    assert bool(result.losses.isfinite().all())
    assert bool((result.losses[result.evaluated[:, 0] > 0.6] == PENALTY).all())
    assert result.stop_reason is not StopReason.FAILED


@pytest.mark.parametrize("value", [math.nan, 1.0])
@pytest.mark.parametrize("name", NAMES)
def test_flat_and_hopeless_objectives_end(name: str, value: float) -> None:
    flat = Probe(lambda population: torch.full((len(population),), value))
    result = OPTIMISERS[name].minimise(flat, 5, Budget(evaluations=300), seed=1)
    assert result.evaluations <= 300
    assert result.best_loss == (PENALTY if math.isnan(value) else value)


@pytest.mark.parametrize("name", NAMES)
def test_every_method_ends_without_a_budget(name: str) -> None:
    result = OPTIMISERS[name].minimise(Probe(), 2, Budget(), seed=1)
    assert result.stop_reason not in (StopReason.FAILED, StopReason.INTERRUPTED, StopReason.SECONDS)
    assert result.best_loss - LOWEST < 1e-2


@pytest.mark.parametrize("name", USE_A_START)
def test_a_start_is_used(name: str) -> None:
    start = torch.full((5,), 0.31)
    result = OPTIMISERS[name].minimise(Probe(), 5, Budget(evaluations=20), seed=1, start=start)
    torch.testing.assert_close(result.evaluated[0], start, rtol=0, atol=1e-6)
    assert result.best_loss <= float(bowl(start[None])[0]) + 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_impossible_arguments_are_named(name: str) -> None:
    with pytest.raises(ParameterError, match="seed"):
        OPTIMISERS[name].minimise(Probe(), 2, Budget(evaluations=5), seed=-1)
    with pytest.raises(ParameterError, match=r"\(2,\)"):
        OPTIMISERS[name].minimise(Probe(), 2, Budget(evaluations=5), seed=1, start=torch.zeros(3))
    with pytest.raises(ParameterError, match="at least one parameter"):
        OPTIMISERS[name].minimise(Probe(), 0, Budget(evaluations=5), seed=1)
