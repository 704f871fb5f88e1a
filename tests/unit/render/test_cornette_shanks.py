"""Cornette-Shanks: normalised, with the mean cosine that theory gives, sampled from its own density."""

import itertools
import math

import numpy as np
import pytest
import torch
from scipy import integrate

from render.cornette_shanks import evaluate_cornette_shanks, sample_cornette_shanks_cosine
from render.errors import ParameterError
from render.phase_functions import evaluate_phase_function
from render.rayleigh_phase import evaluate_rayleigh_phase, sample_rayleigh_cosine
from tests.support.atmospheres import golden
from tests.support.statistics import FALSE_ALARM, histogram_p_value

PARAMETERS = [-0.99, -0.3, 0.0, 1e-5, 0.3, 0.8, 0.99]


def density_of_cosine(cosine: float, asymmetry: float) -> float:
    return 2.0 * math.pi * float(evaluate_cornette_shanks(torch.tensor(cosine, dtype=torch.float64), asymmetry))


def probability_between(low: float, high: float, asymmetry: float, power: int = 0) -> float:
    breaks = [c for c in (-0.9999, -0.99, -0.9, 0.9, 0.99, 0.9999) if low < c < high]
    value, _ = integrate.quad(
        lambda c: c**power * density_of_cosine(c, asymmetry), low, high, points=breaks or None, limit=200, epsabs=1e-12
    )
    return value


@pytest.mark.parametrize("g", PARAMETERS)
def test_it_integrates_to_one_with_the_mean_cosine_of_theory(g: float) -> None:
    assert probability_between(-1.0, 1.0, g) == pytest.approx(1.0, abs=1e-9)
    mean = probability_between(-1.0, 1.0, g, power=1)
    assert mean == pytest.approx(3.0 * g * (4.0 + g * g) / (5.0 * (2.0 + g * g)), abs=1e-9)
    if abs(g) == 0.8:
        assert mean != pytest.approx(g, abs=1e-2)


def test_values_of_the_reference() -> None:
    data = golden("mappings")
    cosine = torch.from_numpy(data["phase_nu"])
    expected = data["phase_mie_g08"]
    assert np.abs(evaluate_cornette_shanks(cosine, 0.8).numpy() / expected - 1.0).max() < 1e-13
    assert np.abs(evaluate_phase_function(cosine, 0.8).numpy() / expected - 1.0).max() > 0.1


def test_without_asymmetry_it_is_the_rayleigh_phase_function_and_samples_alike() -> None:
    uniform = torch.linspace(0.0, 1.0, 101, dtype=torch.float64)
    cosine = 2.0 * uniform - 1.0
    torch.testing.assert_close(evaluate_cornette_shanks(cosine, 0.0), evaluate_rayleigh_phase(cosine))
    torch.testing.assert_close(
        sample_cornette_shanks_cosine(0.0, uniform), sample_rayleigh_cosine(uniform), atol=1e-14, rtol=0.0
    )
    assert float((sample_cornette_shanks_cosine(0.1, uniform) - sample_rayleigh_cosine(uniform)).abs().max()) > 0.01


@pytest.mark.parametrize("g", PARAMETERS)
def test_samples_invert_the_cumulative_distribution(g: float) -> None:
    uniform = torch.tensor([1e-6, 0.01, 0.3, 0.5, 0.9, 0.999], dtype=torch.float64)
    cosines = sample_cornette_shanks_cosine(g, uniform)
    below = [probability_between(-1.0, float(c), g) for c in cosines]
    np.testing.assert_allclose(below, uniform.numpy(), atol=2e-9)
    mirrored = sample_cornette_shanks_cosine(-g, 1.0 - uniform)
    # A last bit of the number is worth the more, the narrower the lobe.
    torch.testing.assert_close(mirrored, -cosines, atol=1e-10 / (1.0 - abs(g)) ** 2, rtol=0.0)


def test_samples_have_its_density_and_not_that_of_henyey_and_greenstein() -> None:
    uniform = torch.rand(50_000, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    edges = np.linspace(-1.0, 1.0, 31)
    counts = np.histogram(sample_cornette_shanks_cosine(0.8, uniform).numpy(), edges)[0]
    expected = [probability_between(low, high, 0.8) for low, high in itertools.pairwise(edges)]
    assert histogram_p_value(counts, len(uniform) * np.array(expected)) > FALSE_ALARM
    other = [probability_between(low, high, 0.78) for low, high in itertools.pairwise(edges)]
    assert histogram_p_value(counts, len(uniform) * np.array(other)) < FALSE_ALARM


def test_a_parameter_at_or_beyond_one_is_refused() -> None:
    for g in (1.0, -1.0, math.nan):
        with pytest.raises(ParameterError, match="Cornette-Shanks"):
            sample_cornette_shanks_cosine(g, torch.tensor([0.5]))


def test_float32_numbers_give_float32_cosines_within_range() -> None:
    cosine = sample_cornette_shanks_cosine(0.8, torch.tensor([0.0, 0.5, 1.0]))
    assert cosine.dtype == torch.float32
    assert bool((cosine.abs() <= 1.0).all())
