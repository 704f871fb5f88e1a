"""Orthonormality, the addition theorem, and the moments of phase functions."""

import math

import numpy as np
import pytest
import torch

from render.cornette_shanks import evaluate_cornette_shanks
from render.phase_functions import evaluate_phase_function
from render.rayleigh_phase import evaluate_rayleigh_phase
from render.spherical_harmonics import (
    compute_phase_moments,
    degrees_of_harmonics,
    evaluate_even_harmonics,
)

DEGREE = 20


def sphere(polar: int, turns: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    cosine, weight = (torch.from_numpy(values) for values in np.polynomial.legendre.leggauss(polar))
    azimuth = (torch.arange(turns, dtype=torch.float64) + 0.5) * (2.0 * math.pi / turns)
    return cosine[:, None], azimuth, weight[:, None].expand(polar, turns) * (2.0 * math.pi / turns)


def test_harmonics_are_orthonormal() -> None:
    cosine, azimuth, weight = sphere(DEGREE + 1, 2 * DEGREE + 1)
    values = evaluate_even_harmonics(cosine, azimuth, DEGREE)
    products = torch.einsum("pti,ptj,pt->ij", values, values, weight)
    torch.testing.assert_close(products, torch.eye(len(products), dtype=torch.float64), atol=1e-12, rtol=0.0)
    coarse_cosine, coarse_azimuth, coarse_weight = sphere(DEGREE - 2, 2 * DEGREE + 1)
    coarse = evaluate_even_harmonics(coarse_cosine, coarse_azimuth, DEGREE)
    wrong = torch.einsum("pti,ptj,pt->ij", coarse, coarse, coarse_weight)
    assert float((wrong - products).abs().max()) > 1e-3


@pytest.mark.parametrize("asymmetry", [0.0, 0.4, -0.3])
def test_moments_convolve_a_phase_function(asymmetry: float) -> None:
    """By the addition theorem, p averaged over a direction and its mirror image is the sum of chi_l Y_lm Y_lm."""
    generator = torch.Generator().manual_seed(3)
    cosine, azimuth = 2.0 * torch.rand(2, 2, 50, generator=generator, dtype=torch.float64) - 1.0
    azimuth = math.pi * azimuth
    moments = compute_phase_moments(lambda c: evaluate_cornette_shanks(c, asymmetry), 60)
    first, second = (evaluate_even_harmonics(c, a, 60) for c, a in zip(cosine, azimuth, strict=True))
    found = (first * second) @ moments[degrees_of_harmonics(60)]
    sines = ((1.0 - cosine**2).sqrt()).prod(0)
    exact = sum(
        0.5 * evaluate_cornette_shanks(cosine.prod(0) + sines * torch.cos(azimuth[0] + sign * azimuth[1]), asymmetry)
        for sign in (1.0, -1.0)
    )
    torch.testing.assert_close(found, exact, atol=1e-7, rtol=0.0)
    assert float((found - 1.01 * exact).abs().max()) > 1e-4


def test_moments_of_known_phase_functions() -> None:
    exact = torch.zeros(9, dtype=torch.float64)
    exact[0], exact[2] = 1.0, 0.1
    torch.testing.assert_close(compute_phase_moments(evaluate_rayleigh_phase, 8), exact, atol=1e-13, rtol=0.0)
    greenstein = compute_phase_moments(lambda c: evaluate_phase_function(c, 0.8), 8)
    torch.testing.assert_close(greenstein, 0.8 ** torch.arange(9, dtype=torch.float64), atol=1e-10, rtol=0.0)
    g = 0.8
    shanks = compute_phase_moments(lambda c: evaluate_cornette_shanks(c, g), 1)
    assert float(shanks[1]) == pytest.approx(3.0 * g * (4.0 + g * g) / (5.0 * (2.0 + g * g)), rel=1e-10)


def test_degrees_stand_in_the_order_of_the_harmonics() -> None:
    assert degrees_of_harmonics(2).tolist() == [0, 1, 2, 1, 2, 2]
    top = evaluate_even_harmonics(torch.ones((), dtype=torch.float64), torch.zeros((), dtype=torch.float64), 2)
    assert top.tolist() == pytest.approx([math.sqrt((2 * l + 1) / (4.0 * math.pi)) for l in (0, 1, 2)] + [0.0] * 3)  # noqa: E741
