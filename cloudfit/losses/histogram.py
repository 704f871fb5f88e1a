"""Distances between histograms: the six of Dobashi et al. 2012 and the second definition of chi-square.

All take float64 histograms of unit mass, h of the rendering and h' of the photograph, and are zero exactly for equal ones. Where the
textbook's form would cancel near its optimum (1 - correlation, 1 - overlap) an equal sum of squares or of positive parts
is taken instead. OpenCV's names are those of `cv2.compareHist`.
"""

import torch
from torch import Tensor

from cloudfit.losses.kinds import Loss

LAST_LEVEL = 255.0

FLAT_SHARE = 1e-12
"""A histogram whose bins differ by less than this share of its norm is flat up to rounding, and correlates with nothing."""


def l1_distance(histogram: Tensor, target: Tensor) -> Tensor:
    """Sum of absolute differences, the objective of Dobashi et al. 2012, eq. 2.

    sum_b |h_b - h'_b|: twice the share of pixels that would have to change level.

    Args:
        histogram: (..., bin).
        target: (..., bin).

    Returns:
        (...) in 0..2 [1].
    """
    return (histogram - target).abs().sum(dim=-1)


def correlation_distance(histogram: Tensor, target: Tensor) -> Tensor:
    """One minus Pearson's correlation r of the bins (OpenCV: HISTCMP_CORREL is r itself).

        1 - r = |u - u'|^2 / 2,    u = (h - mean h) / |h - mean h|

    Two flat histograms are equal, 0; a flat one correlates with no other, 1. (OpenCV 5.0.0 returns r = -1 for a flat
    histogram of large counts against itself.)

    Args:
        histogram: (..., bin).
        target: (..., bin).

    Returns:
        (...) in 0..2 [1].
    """
    (first, first_flat), (second, second_flat) = _centred(histogram), _centred(target)
    distance = 0.5 * (first - second).square().sum(dim=-1)
    return torch.where(first_flat != second_flat, 1.0 + 0.0 * distance, distance)


def _centred(histogram: Tensor) -> tuple[Tensor, Tensor]:
    """Bins less their mean, scaled to unit length, and whether there is nothing to scale `(...)`."""
    centred = histogram - histogram.mean(dim=-1, keepdim=True)
    length = centred.norm(dim=-1, keepdim=True)
    flat = length <= FLAT_SHARE * histogram.norm(dim=-1, keepdim=True)
    return torch.where(flat, torch.zeros_like(centred), centred / torch.where(flat, 1.0, length)), flat[..., 0]


def chi_square_distance(histogram: Tensor, target: Tensor) -> Tensor:
    """Pearson's chi-square with the photograph as the expectation (OpenCV: HISTCMP_CHISQR of photograph and rendering).

    sum_b (h_b - h'_b)^2 / h'_b over the bins with h'_b > 0. As in OpenCV, what the rendering puts where the photograph has nothing
    costs only by what is missing elsewhere, while a bin with a single pixel of the photograph weighs heavily: a rendering that
    misses every level has the loss 1, and one that is nearly right can have more.

    Args:
        histogram: (..., bin).
        target: (..., bin).

    Returns:
        (...) 0 or more, without bound [1].
    """
    expected = target > 0
    terms = (histogram - target).square() / torch.where(expected, target, 1.0)
    # NaN times zero: a histogram that is not a number is not hidden by the photograph's empty bins.
    return torch.where(expected | terms.isnan(), terms, 0.0).sum(dim=-1)


def chi_square_symmetric_distance(histogram: Tensor, target: Tensor) -> Tensor:
    """Chi-square with the mean of both as the expectation (OpenCV: HISTCMP_CHISQR_ALT).

    2 sum_b (h_b - h'_b)^2 / (h_b + h'_b); empty bins of both count nothing.

    Args:
        histogram: (..., bin).
        target: (..., bin).

    Returns:
        (...) in 0..4 [1].
    """
    total = histogram + target
    return 2.0 * ((histogram - target).square() / torch.where(total == 0, 1.0, total)).sum(dim=-1)


def intersection_distance(histogram: Tensor, target: Tensor) -> Tensor:
    """One minus the intersection I = sum_b min(h_b, h'_b) (OpenCV: HISTCMP_INTERSECT is I itself).

    Written sum_b [h'_b - min(h_b, h'_b)]. For histograms of equal mass it is half the L1 distance: its optima are the same.

    Args:
        histogram: (..., bin).
        target: (..., bin), sums to 1.

    Returns:
        (...) in 0..1 [1].
    """
    return (target - torch.minimum(histogram, target)).sum(dim=-1)


def bhattacharyya_distance(histogram: Tensor, target: Tensor) -> Tensor:
    """Distance after Bhattacharyya as OpenCV defines it, also named after Hellinger (HISTCMP_BHATTACHARYYA).

        sqrt(1 - sum_b sqrt(h_b h'_b)) = sqrt(sum_b (sqrt h_b - sqrt h'_b)^2 / 2)

    Args:
        histogram: (..., bin).
        target: (..., bin).

    Returns:
        (...) in 0..1 [1].
    """
    return (0.5 * (histogram.sqrt() - target.sqrt()).square().sum(dim=-1)).sqrt()


def wasserstein_distance(histogram: Tensor, target: Tensor) -> Tensor:
    """One-dimensional earth mover's distance between histograms of equal mass.

    W = sum_b |F_b - F'_b| with the cumulative sums F: the mean number of levels by which a pixel would have to move.

    Args:
        histogram: (..., bin).
        target: (..., bin).

    Returns:
        (...) in 0..bins - 1 [level].
    """
    return (histogram - target).cumsum(dim=-1).abs().sum(dim=-1)


L1 = Loss("l1", 0.0, 2.0, "1", l1_distance)
WASSERSTEIN = Loss("wasserstein", 0.0, LAST_LEVEL, "level", wasserstein_distance)

HISTOGRAM_LOSSES = (
    L1,
    Loss("correlation", 0.0, 2.0, "1", correlation_distance),
    Loss("chi_square", 0.0, float("inf"), "1", chi_square_distance),
    Loss("chi_square_symmetric", 0.0, 4.0, "1", chi_square_symmetric_distance),
    Loss("intersection", 0.0, 1.0, "1", intersection_distance),
    Loss("bhattacharyya", 0.0, 1.0, "1", bhattacharyya_distance),
    WASSERSTEIN,
)
