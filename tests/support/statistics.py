"""Tests of Monte Carlo results by their own variance, corrected for the number of numbers compared."""

import numpy as np
import torch
from scipy import stats
from torch import Tensor

FALSE_ALARM = 1e-3
"""Probability that a right result fails a whole test; seeds are fixed, so it fails always or never."""


def z_scores(difference: Tensor, variance: Tensor) -> Tensor:
    """Differences over their standard deviations, in float64; infinite where a difference has no variance to excuse it."""
    difference, deviation = difference.double(), variance.double().sqrt()
    return torch.where(difference == 0.0, 0.0, difference / deviation)


def accepted_z(tests: int, false_alarm: float = FALSE_ALARM) -> float:
    """Largest |z| that so many independent right results exceed with the given probability in all (Sidak)."""
    return float(stats.norm.isf(0.5 * -np.expm1(np.log1p(-false_alarm) / tests)))


def passes_z_test(difference: Tensor, variance: Tensor, false_alarm: float = FALSE_ALARM) -> bool:
    """Whether no difference is larger than its variance explains, with the correction for their number."""
    return bool((z_scores(difference, variance).abs() <= accepted_z(difference.numel(), false_alarm)).all())


def mean_square_z_p_value(difference: Tensor, variance: Tensor) -> float:
    """Probability that right results differ as much as these all together: chi-square of the sum of z^2.

    For independent numbers with nearly normal noise; it sees a small error shared by many that no single z shows.
    """
    z = z_scores(difference, variance)
    return float(stats.chi2.sf(float(z.square().sum()), z.numel()))


def histogram_p_value(counts: np.ndarray, expected: np.ndarray) -> float:
    """Chi-square test of counts against expected counts; bins that expect fewer than five are pooled."""
    rare = expected < 5.0
    counts = np.append(counts[~rare], counts[rare].sum())
    expected = np.append(expected[~rare], expected[rare].sum())
    if expected[-1] < 5.0:
        counts, expected = counts[:-1], expected[:-1]
    return float(stats.chi2.sf(((counts - expected) ** 2 / expected).sum(), len(counts) - 1))
