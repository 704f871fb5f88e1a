"""Henyey-Greenstein: normalised, with its mean cosine, sampled from its own density, in any frame."""

import math

import numpy as np
import pytest
import torch
from scipy import integrate

from render.errors import ParameterError
from render.phase_functions import (
    LARGEST_ASYMMETRY,
    check_asymmetry,
    evaluate_phase_function,
    rotate_direction,
    sample_directions,
    sample_phase_cosine,
)
from tests.support.statistics import FALSE_ALARM, accepted_z, histogram_p_value

ASYMMETRIES = [-0.99, -0.5, 0.0, 0.3, 0.9, 0.99]
SAMPLES = 100_000


def density_of_cosine(cosine: float, asymmetry: float) -> float:
    return 2.0 * math.pi * float(evaluate_phase_function(torch.tensor(cosine, dtype=torch.float64), asymmetry))


def moment(asymmetry: float, power: int) -> float:
    """Integral of cosine^power times the phase function over the sphere, split where the lobe is narrow."""
    value, _ = integrate.quad(
        lambda c: c**power * density_of_cosine(c, asymmetry), -1.0, 1.0, points=[-0.999, -0.9, 0.9, 0.999], limit=200
    )
    return value


def cumulative(cosine: np.ndarray, asymmetry: float) -> np.ndarray:
    """Probability of a smaller cosine, the closed integral of the phase function."""
    if asymmetry == 0.0:
        return 0.5 * (1.0 + cosine)
    g = asymmetry
    return (1.0 - g * g) / (2.0 * g) * ((1.0 + g * g - 2.0 * g * cosine) ** -0.5 - 1.0 / (1.0 + g))


@pytest.mark.parametrize("asymmetry", ASYMMETRIES)
def test_it_integrates_to_one_and_its_mean_cosine_is_the_asymmetry(asymmetry: float) -> None:
    assert moment(asymmetry, 0) == pytest.approx(1.0, abs=1e-8)
    assert moment(asymmetry, 1) == pytest.approx(asymmetry, abs=1e-8)
    if asymmetry:
        assert moment(-asymmetry, 1) != pytest.approx(asymmetry, abs=0.1)


def test_values_by_hand() -> None:
    cosine = torch.tensor([1.0, 0.0, -1.0], dtype=torch.float64)
    expected = torch.tensor([0.75 / 0.125, 0.75 / 1.25**1.5, 0.75 / 1.5**3], dtype=torch.float64) / (4.0 * math.pi)
    torch.testing.assert_close(evaluate_phase_function(cosine, 0.5), expected)
    torch.testing.assert_close(evaluate_phase_function(cosine, -0.5), expected.flip(0))
    torch.testing.assert_close(evaluate_phase_function(cosine, 0.0), torch.full_like(cosine, 1.0 / (4.0 * math.pi)))


@pytest.mark.parametrize("asymmetry", ASYMMETRIES)
def test_single_precision_agrees_with_double(asymmetry: float) -> None:
    cosine = torch.linspace(-1.0, 1.0, 4001)
    single = evaluate_phase_function(cosine, asymmetry)
    assert single.dtype == torch.float32
    torch.testing.assert_close(
        single.double(), evaluate_phase_function(cosine.double(), asymmetry), rtol=2e-4, atol=0.0
    )
    rounded_beyond_one = evaluate_phase_function(torch.tensor([1.0000001, -1.0000001]), asymmetry)
    torch.testing.assert_close(rounded_beyond_one, single[[-1, 0]], rtol=2e-2, atol=0.0)


def test_its_gradient_is_that_of_the_formula() -> None:
    cosine = torch.linspace(-0.99, 0.99, 7, dtype=torch.float64)
    for value in (-0.8, 0.0, 0.4):
        asymmetry = torch.full((7,), value, dtype=torch.float64, requires_grad=True)
        assert torch.autograd.gradcheck(lambda g: evaluate_phase_function(cosine, g), asymmetry)


def binned_p_value(asymmetry: float, claimed: float) -> float:
    """Chi-square test of sampled cosines against the density of a claimed asymmetry, in bins of equal probability."""
    generator = torch.Generator().manual_seed(0)
    uniform = torch.rand(SAMPLES, generator=generator, dtype=torch.float64)
    cosine = sample_phase_cosine(torch.tensor(asymmetry, dtype=torch.float64), uniform)
    # Folding the density, not the samples: the bins are uniform in the cosine's own cumulative distribution.
    counts, _ = np.histogram(cumulative(cosine.numpy(), claimed), bins=100, range=(0.0, 1.0))
    return histogram_p_value(counts, np.full(100, SAMPLES / 100))


def test_sampled_cosines_follow_the_density() -> None:
    for asymmetry in ASYMMETRIES:
        assert binned_p_value(asymmetry, asymmetry) > FALSE_ALARM / len(ASYMMETRIES)
        assert binned_p_value(asymmetry, 0.9 * asymmetry + 0.05) < 1e-6


def test_the_cumulative_distribution_belongs_to_the_density() -> None:
    for asymmetry in ASYMMETRIES:
        for cosine in (-0.9, 0.1, 0.95):
            integral, _ = integrate.quad(density_of_cosine, -1.0, cosine, args=(asymmetry,), points=[-0.99], limit=200)
            assert float(cumulative(np.array(cosine), asymmetry)) == pytest.approx(integral, abs=1e-8)


@pytest.mark.parametrize("asymmetry", [*ASYMMETRIES, 1e-6, -1e-6, LARGEST_ASYMMETRY, -LARGEST_ASYMMETRY])
def test_the_sampler_inverts_and_keeps_within_bounds(asymmetry: float) -> None:
    uniform = torch.linspace(0.0, 1.0, 1001)
    single = sample_phase_cosine(torch.tensor(asymmetry), uniform)
    double = sample_phase_cosine(torch.tensor(asymmetry, dtype=torch.float64), uniform.double())
    assert single.abs().max() <= 1.0
    assert (double.diff() > 0.0).all()
    torch.testing.assert_close(single.double(), double, atol=2e-4, rtol=0.0)
    assert double[[0, -1]].tolist() == pytest.approx([-1.0, 1.0])
    if abs(asymmetry) > 1e-3:
        np.testing.assert_allclose(cumulative(double.numpy(), asymmetry), uniform.numpy(), atol=2e-7)


AXES = torch.nn.functional.normalize(
    torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.3, -0.5, -0.1], [1e-4, 0.0, -1.0]]), dim=-1
)


def test_turned_directions_have_their_cosine_around_every_axis() -> None:
    azimuth = torch.linspace(0.0, 2.0 * math.pi, 9)[:-1]
    for cosine in (-1.0, -0.6, 0.0, 0.999, 1.0):
        for axis in AXES:
            turned = rotate_direction(axis.expand(8, 3), torch.full((8,), cosine), azimuth)
            torch.testing.assert_close(torch.linalg.vector_norm(turned, dim=-1), torch.ones(8))
            torch.testing.assert_close(turned @ axis, torch.full((8,), cosine), atol=1e-6, rtol=0.0)
            torch.testing.assert_close(turned.mean(0), cosine * axis, atol=1e-6, rtol=0.0)
            if abs(cosine) < 0.9:
                assert (turned[1:] - turned[:-1]).norm(dim=-1).min() > 0.1


def azimuth_p_value(direction: torch.Tensor, axis: torch.Tensor) -> float:
    """Chi-square test of directions for a uniform azimuth around an axis."""
    helper = torch.tensor([0.0, 1.0, 0.0])
    first = torch.nn.functional.normalize(torch.linalg.cross(axis, helper), dim=0)
    second = torch.linalg.cross(axis, first)
    angle = torch.atan2(direction @ second, direction @ first)
    counts, _ = np.histogram(angle.numpy(), bins=36, range=(-math.pi, math.pi))
    return histogram_p_value(counts, np.full(36, len(direction) / 36))


def test_sampled_directions_have_mean_cosine_and_uniform_azimuth() -> None:
    bound = accepted_z(len(AXES) * len(ASYMMETRIES))
    for number, axis in enumerate(AXES):
        for asymmetry in ASYMMETRIES:
            generator = torch.Generator().manual_seed(number)
            direction = sample_directions(axis.expand(20_000, 3), torch.full((20_000,), asymmetry), generator)
            cosine = (direction @ axis).double()
            assert abs(float((cosine.mean() - asymmetry) / (cosine.std() / math.sqrt(20_000)))) < bound
            assert azimuth_p_value(direction, axis) > FALSE_ALARM / (len(AXES) * len(ASYMMETRIES))
    assert azimuth_p_value(direction + 0.02, axis) < 1e-4


def test_a_generator_gives_the_same_directions_again() -> None:
    asymmetry = torch.zeros(len(AXES))
    first, again, other = (
        sample_directions(AXES, asymmetry, torch.Generator().manual_seed(seed)) for seed in (1, 1, 2)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("asymmetry", [1.0, -1.0, 0.9995, math.nan, math.inf, -2.0])
def test_delta_functions_are_refused(asymmetry: float) -> None:
    with pytest.raises(ParameterError, match="delta function"):
        check_asymmetry(asymmetry)
    with pytest.raises(ParameterError, match=f"{asymmetry:.6g}".replace("+", r"\+")):
        check_asymmetry(torch.tensor([0.0, asymmetry, 0.5]))


def test_asymmetries_within_bounds_are_taken() -> None:
    check_asymmetry(LARGEST_ASYMMETRY)
    check_asymmetry(torch.tensor([-LARGEST_ASYMMETRY, 0.0, 0.9]))
