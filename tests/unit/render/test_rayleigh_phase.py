"""Rayleigh: normalised, without a mean direction, sampled from its own density, and the reference's values."""

import math

import numpy as np
import pytest
import torch

from render.cornette_shanks import evaluate_cornette_shanks
from render.rayleigh_phase import evaluate_rayleigh_phase, sample_rayleigh_cosine
from tests.support.atmospheres import golden
from tests.support.statistics import FALSE_ALARM, histogram_p_value

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


def moment(power: int, evaluate=evaluate_rayleigh_phase) -> float:
    values = evaluate(torch.from_numpy(NODES)).numpy()
    return float(2.0 * math.pi * (WEIGHTS * NODES**power * values).sum())


def test_it_integrates_to_one_and_scatters_forwards_as_much_as_backwards() -> None:
    assert moment(0) == pytest.approx(1.0, abs=1e-14)
    assert moment(1) == pytest.approx(0.0, abs=1e-14)
    assert moment(2) == pytest.approx(0.4, abs=1e-14)
    isotropic = moment(2, lambda cosine: torch.full_like(cosine, 1.0 / (4.0 * math.pi)))
    assert isotropic != pytest.approx(0.4, abs=0.05)


def test_values_of_the_reference() -> None:
    data = golden("mappings")
    cosine = torch.from_numpy(data["phase_nu"])
    assert np.abs(evaluate_rayleigh_phase(cosine).numpy() - data["phase_rayleigh"]).max() < 1e-15
    assert np.abs(evaluate_cornette_shanks(cosine, 0.0).numpy() - data["phase_rayleigh"]).max() < 1e-15
    assert np.abs(evaluate_cornette_shanks(cosine, 0.1).numpy() - data["phase_rayleigh"]).max() > 1e-3


def test_samples_have_its_density() -> None:
    uniform = torch.rand(100_000, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    edges = np.linspace(-1.0, 1.0, 41)
    counts = np.histogram(sample_rayleigh_cosine(uniform).numpy(), edges)[0]
    probability = np.diff((edges**3 + 3.0 * edges + 4.0) / 8.0)
    assert histogram_p_value(counts, len(uniform) * probability) > FALSE_ALARM
    isotropic = np.full(40, len(uniform) / 40.0)
    assert histogram_p_value(counts, isotropic) < 1e-9


def test_the_ends_of_the_interval_are_the_poles() -> None:
    ends = sample_rayleigh_cosine(torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64))
    torch.testing.assert_close(ends, torch.tensor([-1.0, 0.0, 1.0], dtype=torch.float64), atol=1e-15, rtol=0.0)
