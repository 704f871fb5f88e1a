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
    evaluate_harmonics,
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


def unit_vectors(count: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=1)


def test_all_harmonics_are_orthonormal() -> None:
    degree = 6
    cosine, azimuth, weight = sphere(degree + 1, 2 * degree + 2)
    sine = (1.0 - cosine**2).sqrt()
    direction = torch.stack([sine * azimuth.cos(), sine * azimuth.sin(), cosine.expand(-1, len(azimuth))], dim=-1)
    values = evaluate_harmonics(direction, degree)
    assert values.shape == (*direction.shape[:2], (degree + 1) ** 2)
    products = torch.einsum("pti,ptj,pt->ij", values, values, weight)
    one = torch.eye((degree + 1) ** 2, dtype=torch.float64)
    torch.testing.assert_close(products, one, atol=1e-12, rtol=0.0)
    swapped = evaluate_harmonics(direction[..., [1, 0, 2]], degree)
    wrong = torch.einsum("pti,ptj,pt->ij", values, swapped, weight)
    assert float((wrong - one).abs().max()) > 0.5


@pytest.mark.parametrize("asymmetry", [0.0, 0.5, -0.6])
def test_addition_theorem_of_any_two_directions(asymmetry: float) -> None:
    """Sums of g^l Y_lm Y_lm are the phase function between the directions: no plane of symmetry is needed."""
    first, second = unit_vectors(50, 1), unit_vectors(50, 2)
    products = evaluate_harmonics(first, 40) * evaluate_harmonics(second, 40)
    found = products @ torch.tensor(asymmetry, dtype=torch.float64) ** degrees_of_harmonics(40, odd=True)
    exact = evaluate_phase_function((first * second).sum(1), asymmetry)
    torch.testing.assert_close(found, exact, atol=1e-6, rtol=0.0)
    assert float((found - evaluate_phase_function((first * second).sum(1), asymmetry + 0.01)).abs().max()) > 1e-4


def test_all_harmonics_begin_with_the_even_ones() -> None:
    direction = unit_vectors(20, 3)
    azimuth = torch.atan2(direction[:, 1], direction[:, 0])
    even = evaluate_even_harmonics(direction[:, 2], azimuth, 3)
    found = evaluate_harmonics(direction, 3)
    torch.testing.assert_close(found[:, :10], even)
    # A mirror image in y changes the sign of the others and of nothing else.
    mirrored = evaluate_harmonics(direction * torch.tensor([1.0, -1.0, 1.0]), 3)
    torch.testing.assert_close(mirrored[:, :10], even)
    torch.testing.assert_close(mirrored[:, 10:], -found[:, 10:])
    assert float(found[:, 10:].abs().amax(0).min()) > 0.1


def test_poles_have_harmonics_too() -> None:
    for sign in (1.0, -1.0):
        pole = evaluate_harmonics(torch.tensor([0.0, 0.0, sign], dtype=torch.float64), 2)
        of_zero = [math.sqrt((2 * l + 1) / (4.0 * math.pi)) * sign**l for l in (0, 1, 2)]  # noqa: E741
        assert pole.tolist() == pytest.approx(of_zero + [0.0] * 6)


def test_degrees_of_all_harmonics_repeat_those_that_are_odd() -> None:
    assert degrees_of_harmonics(2, odd=True).tolist() == [0, 1, 2, 1, 2, 2, 1, 2, 2]
    assert degrees_of_harmonics(0, odd=True).tolist() == [0]
    counts = degrees_of_harmonics(5, odd=True).bincount()
    assert counts.tolist() == [2 * l + 1 for l in range(6)]  # noqa: E741
