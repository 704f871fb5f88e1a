"""Real spherical harmonics, all or those that are even in azimuth, and phase functions as convolutions with them.

By the addition theorem, a phase function p(c) = sum over l of (2 l + 1) / (4 pi) chi_l P_l(c) turns the coefficients L_lm of a radiance
into chi_l L_lm of what it scatters: no angle between two directions is ever needed. For Henyey and Greenstein's, chi_l is g^l. In a plane
or spherical atmosphere radiance is symmetric about the plane of sun and zenith, so harmonics with cos(m azimuth) are all there are.
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
    legendre = _normalised_legendre(cosine, degree)
    waves = [torch.cos(m * azimuth) for m in range(degree + 1)]
    return torch.stack([of_l * wave for of_m, wave in zip(legendre, waves, strict=True) for of_l in of_m], dim=-1)


def evaluate_harmonics(direction: Tensor, degree: int) -> Tensor:
    """All orthonormal real spherical harmonics: those of `evaluate_even_harmonics`, then with sin(m azimuth) those that are odd.

    Args:
        direction: unit vectors `(..., 3)`, float64; the third component is the cosine of the polar angle.
        degree: largest l.

    Returns:
        `(..., (degree + 1)^2)`, each part ordered by m, then by l.
    """
    legendre = _normalised_legendre(direction[..., 2], degree)
    azimuth = torch.atan2(direction[..., 1], direction[..., 0])
    waves = [(torch.cos(m * azimuth), torch.sin(m * azimuth)) for m in range(degree + 1)]
    even, odd = (
        [of_l * wave[part] for of_m, wave in zip(legendre[first:], waves[first:], strict=True) for of_l in of_m]
        for part, first in ((0, 0), (1, 1))
    )
    return torch.stack([*even, *odd], dim=-1)


def _normalised_legendre(cosine: Tensor, degree: int) -> list[list[Tensor]]:
    """N_lm P_lm for each m, and for each l from m to `degree`."""
    sine = ((1.0 - cosine) * (1.0 + cosine)).clamp(min=0.0).sqrt()
    found = []
    diagonal = torch.full_like(cosine, math.sqrt(0.25 / math.pi))
    for m in range(degree + 1):
        if m:
            diagonal = diagonal * sine * math.sqrt((2.0 * m + 1.0) / (2.0 * m) * (2.0 if m == 1 else 1.0))
        before, legendre, of_m = torch.zeros_like(cosine), diagonal, list[Tensor]()
        for l in range(m, degree + 1):  # noqa: E741 - the letter of every text on the subject
            of_m.append(legendre)
            a = math.sqrt((2.0 * l + 3.0) * (2.0 * l + 1.0) / ((l + 1.0 - m) * (l + 1.0 + m)))
            b = math.sqrt((2.0 * l + 3.0) * (l - m) * (l + m) / ((2.0 * l - 1.0) * (l + 1.0 - m) * (l + 1.0 + m)))
            before, legendre = legendre, a * cosine * legendre - b * before
        found.append(of_m)
    return found


def degrees_of_harmonics(degree: int, odd: bool = False) -> Tensor:
    """The l of each harmonic `(harmonic,)`, int64, as `evaluate_even_harmonics` orders them; with `odd` as `evaluate_harmonics` does."""
    orders = [*range(degree + 1), *(range(1, degree + 1) if odd else ())]
    return torch.tensor([l for m in orders for l in range(m, degree + 1)])  # noqa: E741


def compute_phase_moments(phase: Callable[[Tensor], Tensor], degree: int) -> Tensor:
    """Moments of a phase function, chi_l = 2 pi integral of p(c) P_l(c) dc, `(degree + 1,)` [1], float64; the first is 1.

    Args:
        phase: of the cosine of the scattering angle [1/sr].
        degree: largest l.
    """
    cosine, weight = np.polynomial.legendre.leggauss(PHASE_NODES)
    polynomials = torch.from_numpy(np.polynomial.legendre.legvander(cosine, degree))
    return 2.0 * math.pi * (torch.from_numpy(weight) * phase(torch.from_numpy(cosine))) @ polynomials
