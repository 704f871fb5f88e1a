"""The search of a fit: on some of the cloud's pixels, then on all of them among the best points found.

A loss of histograms is a matter of counting, and a sample of the pixels counts nearly as well at a part of the price: with n of them its
floor is that of n pixels. So the optimiser runs on a sample; its best points are scored on all pixels, and a few generations bred
from these settle there what a sample cannot tell.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import torch
from torch import Tensor

from cloudfit.fit_problem import FitProblem
from cloudfit.fit_types import FitOptions
from cloudfit.optimisers import OPTIMISERS
from cloudfit.optimisers.base import Budget, EvaluationLog, OptimiserResult, StopReason, pool_results, run_logged
from cloudfit.optimisers.screened_evolution import ScreenedEvolution

USUAL_EVALUATIONS = 730
"""Of one search without a budget; the progress that is shown goes by it."""

RESCORED = 64
"""Best points of the sample that are scored on all pixels; of six photographs, three seeds each, the best was always among the first 48."""

APART = 0.01
"""In the unit cube, between two of them: the end of a search crowds around one point."""

SETTLING = ScreenedEvolution(largest_iterations=6, patience=6)
"""What breeds on all pixels. Its 120 evaluations gain as much as as many of SBPLX, and being batches take 0.3 s instead of 0.8."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class SearchOutcome:
    """What a search found.

    Args:
        sampled: the problem on which the optimiser ran; the whole one where it is small.
        coarse: its points and losses there.
        final: points and losses of all pixels; the same as `coarse` if the sample is the whole.
    """

    sampled: FitProblem
    coarse: OptimiserResult
    final: OptimiserResult

    @property
    def evaluations(self) -> int:
        """On the sample and on all pixels together."""
        return self.coarse.evaluations + (0 if self.final is self.coarse else self.final.evaluations)

    @property
    def history(self) -> Tensor:
        """Best loss after each batch `(iteration,)`, of the sample first: its losses lie higher, as its floor does."""
        return (
            self.final.history
            if self.final is self.coarse
            else torch.cat([self.coarse.history, self.final.history.clamp(max=float(self.coarse.history[-1]))])
        )

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended it."""
        return StopReason.INTERRUPTED in (self.coarse.stop_reason, self.final.stop_reason)


def search_parameters(
    problem: FitProblem, options: FitOptions, on_progress: Progress = lambda stage, share: None
) -> SearchOutcome:
    """Run the optimiser from independent seeds on a sample of the pixels, and settle on all of them what it found.

    Args:
        problem: on all pixels.
        options: optimiser, its budgets, and the size of the sample.
        on_progress: called with "search: loss ..." and the share that is done.
    """
    sampled = problem.sampled(options.search_pixels)
    coarse = _run(sampled, options, on_progress)
    if sampled is problem:
        return SearchOutcome(sampled, coarse, coarse)
    return SearchOutcome(sampled, coarse, _settle(problem, coarse, options.seed))


def _run(problem: FitProblem, options: FitOptions, on_progress: Progress) -> OptimiserResult:
    """Run the optimiser several times and pool what was evaluated."""
    budget = Budget(
        None if options.evaluations is None else max(1, options.evaluations // options.searches),
        None if options.seconds is None else options.seconds / options.searches,
        None,
    )
    minimiser = OPTIMISERS[options.optimiser]
    results: list[OptimiserResult] = []

    def report(iteration: int, evaluations: int, best_loss: float) -> None:
        best = min([best_loss, *(result.best_loss for result in results)])
        share = (len(results) + min(1.0, evaluations / (budget.evaluations or USUAL_EVALUATIONS))) / options.searches
        on_progress(f"search: loss {best:.3f}", share)

    for run in range(options.searches):
        seed = options.seed * options.searches + run
        results.append(minimiser.minimise(problem, problem.space.dimension, budget, seed, report))
        if results[-1].stop_reason is StopReason.INTERRUPTED:
            break
    return pool_results(results)


def _settle(problem: FitProblem, coarse: OptimiserResult, seed: int) -> OptimiserResult:
    """Score the best points of a search on all pixels, and breed from them there; after an interruption only score the best."""
    points = coarse.evaluated[_best_apart(coarse.evaluated, coarse.losses)]

    def breed_from_scored(log: EvaluationLog) -> StopReason:
        state = SETTLING.resume(points, log.evaluate(points), seed)
        while SETTLING.stop_reason(state) is None:
            population, state = SETTLING.ask(state)
            state = SETTLING.tell(state, population, log.evaluate(population))
        return coarse.stop_reason

    def score_best(log: EvaluationLog) -> StopReason:
        log.evaluate(points[:1])
        return StopReason.INTERRUPTED

    if coarse.stop_reason is not StopReason.INTERRUPTED:
        # An interruption before anything is scored must not lose what the search had found.
        with suppress(KeyboardInterrupt):
            return run_logged(breed_from_scored, problem, problem.space.dimension, Budget())
    return run_logged(score_best, problem, problem.space.dimension, Budget())


def _best_apart(points: Tensor, losses: Tensor) -> Tensor:
    """Numbers of the best points that keep a distance from better ones, at most `RESCORED`."""
    order = losses.argsort(stable=True)[: 8 * RESCORED]
    chosen: list[int] = []
    for number in order.tolist():
        if not chosen or float((points[chosen] - points[number]).abs().amax(dim=1).min()) >= APART:
            chosen.append(number)
        if len(chosen) == RESCORED:
            break
    return torch.tensor(chosen)
