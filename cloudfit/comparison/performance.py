"""What experts ask of a comparison of optimisers, as plain functions of the runs; every definition with its source.

Losses of different problems are made comparable by the relative excess over the best loss f* that any method found,

    e = (f - f*) / max(f*, f_floor),

with the floor f_floor of the loss, below which two images cannot be told apart: where f* is above it, e = 0.01 means 1 % above the best
loss; where f* is zero, a relative excess would mean nothing. Sources:

- COCO: Hansen, Auger, Ros, Mersmann, Tusar, Brockhoff, "COCO: a platform for comparing continuous optimizers in a black-box
  setting", Optimization Methods and Software 36, 2021.
- Moré and Wild, "Benchmarking derivative-free optimization algorithms", SIAM Journal on Optimization 20, 2009.
- López-Ibáñez, Vermetten, Dreo, Doerr, "Using the empirical attainment function for analyzing single-objective black-box
  optimization algorithms", IEEE Transactions on Evolutionary Computation, 2024.
"""

import math
from collections.abc import Sequence

import numpy as np

from cloudfit.comparison.run_record import Floats, RunRecord, Trace
from render.errors import ParameterError

LOWEST_EXCESS, HIGHEST_EXCESS = 1e-3, 1e1
"""Bounds of the targets and of the anytime area: 0.1 % above the best loss, and 11 times the best loss."""

TARGETS_PER_DECADE = 10

SUCCESS_EXCESS = 0.01
"""A run succeeds that ends within 1 % of the best loss that anyone found."""

PROFILE_TOLERANCE = 0.01
"""tau of the data profiles: the share of the possible reduction of the loss that a run may fall short of."""

TIME_DECADES = 2.0
"""Decades of wall time, up to the horizon, over which the anytime area in seconds is taken; before them, imports and luck rule."""


def target_excesses() -> Floats:
    """Log-spaced targets of the excess, `(target,)`, the hardest last."""
    decades = math.log10(HIGHEST_EXCESS / LOWEST_EXCESS)
    return np.logspace(math.log10(HIGHEST_EXCESS), math.log10(LOWEST_EXCESS), round(TARGETS_PER_DECADE * decades) + 1)


def excess(loss: Floats | float, best: float, floor: float) -> Floats:
    """Relative excess e = (f - f*) / max(f*, f_floor), 0 or more.

    Args:
        loss: f, any shape [loss]; infinite where there is none.
        best: f*, the best loss that any method found on the problem.
        floor: f_floor, the loss below which nothing can be told apart.

    Raises:
        ParameterError: when both best and floor are zero or less.
    """
    scale = max(best, floor)
    if not scale > 0.0:
        raise ParameterError(f"expected a positive best loss or floor, got {best} and {floor}")
    return np.maximum(0.0, (np.asarray(loss, dtype=float) - best) / scale)


def loss_of_excess(excesses: Floats | float, best: float, floor: float) -> Floats:
    """Loss f* + e max(f*, f_floor) that has this excess; the inverse of `excess`."""
    return best + np.asarray(excesses, dtype=float) * max(best, floor)


def score(excesses: Floats) -> Floats:
    """Where an excess lies between the bounds, in logarithms: 1 at the lowest and below, 0 at the highest and above.

    s = (log e_high - log e) / (log e_high - log e_low), clamped to 0..1.
    """
    clamped = np.clip(excesses, LOWEST_EXCESS, HIGHEST_EXCESS)
    return np.log(HIGHEST_EXCESS / clamped) / math.log(HIGHEST_EXCESS / LOWEST_EXCESS)


def anytime_area(trace: Trace, clock: Floats, begin: float, end: float, best: float, floor: float) -> float:
    """Area over the convergence curve, AOCC: the mean score of the best loss so far over the logarithm of time.

    AOCC = 1 / ln(t_1 / t_0) integral from t_0 to t_1 of s(e(t)) dt / t

    with the excess e(t) of the best loss known at time t and the score s between the bounds of `score`; nothing known scores 0. It is
    the area under the runtime distribution over infinitely many log-spaced targets (López-Ibáñez et al. 2024). Their time is linear;
    here it is logarithmic, so that the beginning of a run counts as much as its end.

    Args:
        trace: of the run.
        clock: `trace.evaluation` or `trace.seconds`: what time means.
        begin: t_0, more than zero.
        end: t_1, more than t_0.
        best: f*.
        floor: f_floor.

    Returns:
        0..1, larger is better.

    Raises:
        ParameterError: when there is no time between begin and end.
    """
    if not 0.0 < begin < end:
        raise ParameterError(f"expected 0 < begin < end, got {begin} and {end}")
    inner = clock[(clock > begin) & (clock < end)]
    times = np.concatenate([[begin], inner, [end]])
    steps = np.diff(np.log(times))
    scores = score(excess(trace.best_at(times[:-1], clock), best, floor))
    return float((scores * steps).sum() / steps.sum())


def runtimes(runs: Sequence[RunRecord], best: float, floor: float, by_seconds: bool) -> Floats:
    """First time at which each run reached each target `(run, target)`, infinite where it never did (COCO, runtimes).

    Args:
        runs: of one problem.
        best: f*.
        floor: f_floor.
        by_seconds: whether time is wall time [s] instead of evaluations.
    """
    targets = loss_of_excess(target_excesses(), best, floor)
    table = np.full((len(runs), len(targets)), math.inf)
    for row, run in enumerate(runs):
        until = run.trace.seconds_until if by_seconds else run.trace.evaluations_until
        table[row] = [until(float(target)) for target in targets]
    return table


def distribution(times: Floats, grid: Floats) -> Floats:
    """Empirical distribution of runtimes: the share of all (problem, run, target) that was reached within each time (COCO).

    F(t) = |{i: T_i <= t}| / n, infinite T_i included in n.

    Args:
        times: any shape, infinite where a target was never reached.
        grid: `(time,)`.

    Returns:
        `(time,)` in 0..1.
    """
    ordered = np.sort(times.ravel())
    return np.searchsorted(ordered, grid, side="right") / len(ordered)


def profile_target(first_losses: Floats, best: float, tolerance: float = PROFILE_TOLERANCE) -> float:
    """Loss at which a run counts as converged in a data profile: f_L + tau (f_0 - f_L)  (Moré and Wild 2009, section 2).

    f_L is the best loss that any method found. f_0 is the loss of a common start there; these methods have none in common, so it is
    the median first loss of all runs on the problem.

    Args:
        first_losses: of all runs on the problem `(run,)`.
        best: f_L.
        tolerance: tau.
    """
    return best + tolerance * max(0.0, float(np.median(first_losses)) - best)


def simplex_gradients(evaluations: Floats, dimension: int) -> Floats:
    """Evaluations in units of a simplex gradient, t / (n + 1), the abscissa of data profiles (Moré and Wild 2009, section 2.2).

    The share of runs with at most alpha of them, `distribution` over alpha, is the data profile d(alpha).
    """
    return np.asarray(evaluations, dtype=float) / (dimension + 1)


def expected_running_time(spent: Floats, succeeded: Sequence[bool]) -> float:
    """ERT: what has been spent by all runs for each success (COCO; Price 1997).

    ERT = (sum over runs of the time until success, or of the whole run without one) / (number of successes)

    Args:
        spent: time of each run until its success, or until its end `(run,)`.
        succeeded: whether it succeeded.

    Returns:
        In the unit of `spent`; infinite without a success.
    """
    successes = sum(map(bool, succeeded))
    return float(np.sum(spent)) / successes if successes else math.inf


def quartiles(values: Sequence[float] | Floats) -> tuple[float, float, float]:
    """Lower quartile, median, upper quartile, interpolated linearly."""
    low, median, high = np.quantile(np.asarray(values, dtype=float), [0.25, 0.5, 0.75])
    return float(low), float(median), float(high)
