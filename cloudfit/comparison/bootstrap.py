"""Is one method better than another beyond the choice of problems: a paired bootstrap over problems."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cloudfit.comparison.run_record import Floats

RESAMPLES = 4000
CONFIDENCE = 0.95

EXHAUSTIVE_PAIRS, RANDOM_PATTERNS = 14, 10_000


@dataclass(frozen=True)
class Contrast:
    """One method against another.

    Args:
        first, second: names.
        difference: mean over the problems of first minus second.
        low, high: ends of the confidence interval of the difference.
        wins: share of the problems on which the first is ahead; ties count half.
        p_value: two-sided, before the correction for many pairs.
        p_corrected: after it.
    """

    first: str
    second: str
    difference: float
    low: float
    high: float
    wins: float
    p_value: float
    p_corrected: float


def compare_pairs(values: Mapping[str, Floats], seed: int = 0, resamples: int = RESAMPLES) -> list[Contrast]:
    """Compare all pairs of methods on the same problems.

    The problems, not the runs, are the sample. For the interval each resample draws as many problems as there are, with replacement, and
    takes the mean difference over them; the interval lies between quantiles of these means (percentile bootstrap: Efron and Tibshirani,
    "An introduction to the bootstrap", 1993, chapter 13). With few problems it is too narrow, so the p-value is that of `sign_flip_test`,
    which is not; for the number of pairs it is corrected by `holm`.

    Args:
        values: by method, the mean over seeds of a figure of merit on each problem `(problem,)`; larger is better.
        seed: of the resampling.
        resamples: how many.

    Returns:
        A contrast for each pair, in the order of the names given.
    """
    names = list(values)
    pairs = [(a, b) for number, a in enumerate(names) for b in names[number + 1 :]]
    if not pairs:
        return []
    count = len(values[names[0]])
    drawn = np.random.default_rng(seed).integers(0, count, (resamples, count))
    found = []
    for first, second in pairs:
        difference = np.asarray(values[first], float) - np.asarray(values[second], float)
        means = difference[drawn].mean(1)
        low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
        wins = float((difference > 0).mean() + 0.5 * (difference == 0).mean())
        p_value = sign_flip_test(difference, seed)
        found.append((first, second, float(difference.mean()), float(low), float(high), wins, p_value))
    corrected = holm([row[-1] for row in found])
    return [Contrast(*row, p_corrected) for row, p_corrected in zip(found, corrected, strict=True)]


def sign_flip_test(differences: Floats, seed: int = 0) -> float:
    """Two-sided p-value of a mean difference of zero between paired values, by flipping their signs.

    Were the methods equal, each difference would have either sign with the same probability. p is the share of the sign patterns, the one
    observed included, whose mean is at least as far from zero (Fisher's randomisation test; Pitman 1937). Up to 14 pairs all patterns are
    counted, so that n pairs cannot give less than 2 / 2^n; beyond that 10 000 random ones and the observed one.

    Args:
        differences: `(problem,)`.
        seed: of the random patterns.
    """
    count = len(differences)
    if count <= EXHAUSTIVE_PAIRS:
        bits = np.arange(2**count)[:, None] >> np.arange(count)[None, :] & 1
        signs = 1.0 - 2.0 * bits
    else:
        drawn = np.random.default_rng(seed).integers(0, 2, (RANDOM_PATTERNS, count))
        signs = np.concatenate([np.ones((1, count)), 1.0 - 2.0 * drawn])
    means = np.abs((signs * differences).mean(1))
    observed = abs(float(np.mean(differences)))
    return float((means >= observed * (1.0 - 1e-12)).mean())


def holm(p_values: list[float]) -> list[float]:
    """p-values corrected for their number m (Holm, "A simple sequentially rejective multiple test procedure", 1979).

    Of the i-th smallest, from 1: the largest (m - j + 1) p_(j) with j <= i, at most 1.
    """
    order = sorted(range(len(p_values)), key=p_values.__getitem__)
    corrected, running = [0.0] * len(p_values), 0.0
    for rank, index in enumerate(order):
        running = max(running, min(1.0, (len(p_values) - rank) * p_values[index]))
        corrected[index] = running
    return corrected
