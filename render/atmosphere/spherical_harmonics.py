"""Spherical harmonics that are even in azimuth, and phase functions as convolutions with them.

By the addition theorem, a phase function p(c) = sum over l of (2 l + 1) / (4 pi) chi_l P_l(c) turns the coefficients L_lm of a radiance
into chi_l L_lm of what it scatters: no angle between two directions is ever needed. Radiance is symmetric about the plane of sun
and zenith, so harmonics with cos(m azimuth) are all there are.
"""

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

PHASE_NODES = 512
"""Gauss-Legendre nodes of the moments of a phase function, more than any lobe in use needs."""


def evaluate_even_harmonics(cosine: Tensor, azimuth: Tensor, degree: int) -> Tensor:
    """Orthonormal real spherical harmonics that are even in azimuth.

        Y_lm = N_lm P_lm(c) cos(m azimuth),   m = 0 .. l

    The fully normalised Legendre functions come from the recursion in l at fixed m (Holmes & Featherstone 2002, equations 11 to
    13), which is stable to any degree in use.

    Args:
        cosine: of the polar angle `(...)`, float64.
        azimuth: `(...)` [rad].
        degree: largest l.

    Returns:
        `(..., harmonic)`, ordered by m, then by l from m to `degree`; orthonormal over the whole sphere.
    """
    cosine, azimuth = torch.broadcast_tensors(cosine, azimuth)
    sine = ((1.0 - cosine) * (1.0 + cosine)).clamp(min=0.0).sqrt()
    found = []
    diagonal = torch.full_like(cosine, math.sqrt(0.25 / math.pi))
    for m in range(degree + 1):
        if m:
            diagonal = diagonal * sine * math.sqrt((2.0 * m + 1.0) / (2.0 * m) * (2.0 if m == 1 else 1.0))
        wave = torch.cos(m * azimuth)
        before, legendre = torch.zeros_like(cosine), diagonal
        for l in range(m, degree + 1):  # noqa: E741 - the letter of every text on the subject
            found.append(legendre * wave)
            a = math.sqrt((2.0 * l + 3.0) * (2.0 * l + 1.0) / ((l + 1.0 - m) * (l + 1.0 + m)))
            b = math.sqrt((2.0 * l + 3.0) * (l - m) * (l + m) / ((2.0 * l - 1.0) * (l + 1.0 - m) * (l + 1.0 + m)))
            before, legendre = legendre, a * cosine * legendre - b * before
    return torch.stack(found, dim=-1)


def degrees_of_harmonics(degree: int) -> Tensor:
    """The l of each harmonic `(harmonic,)`, int64, in the order of `evaluate_even_harmonics`."""
    return torch.tensor([l for m in range(degree + 1) for l in range(m, degree + 1)])  # noqa: E741


def compute_phase_moments(phase: Callable[[Tensor], Tensor], degree: int) -> Tensor:
    """Moments of a phase function, chi_l = 2 pi integral of p(c) P_l(c) dc, `(degree + 1,)` [1], float64; the first is 1.

    Args:
        phase: of the cosine of the scattering angle [1/sr].
        degree: largest l.
    """
    cosine, weight = np.polynomial.legendre.leggauss(PHASE_NODES)
    polynomials = torch.from_numpy(np.polynomial.legendre.legvander(cosine, degree))
    return 2.0 * math.pi * (torch.from_numpy(weight) * phase(torch.from_numpy(cosine))) @ polynomials
