import itertools
import math

import numpy as np
import pytest
import torch

from render.media import MEDIA, FlightDistribution, compute_in_scattering
from tests.support.statistics import FALSE_ALARM, histogram_p_value

SAMPLES, BINS = 40_000, 50

CASES = [  # height, slope, slope towards the sun, distance; fog 100 m thick
    (30.0, 0.0, None, 200.0),
    (30.0, 0.0, None, math.inf),
    (30.0, 0.4, None, math.inf),
    (200.0, -0.5, None, math.inf),
    (30.0, 0.3, 0.3, 80.0),
    (30.0, 0.9, 0.2, math.inf),
    (30.0, 0.3, 0.3 + 1e-12, 80.0),
    (200.0, -0.7, 0.4, math.inf),
    (10.0, 0.2, -0.6, 90.0),
]


def flight(name: str, case: tuple, extinction: float = 0.02) -> FlightDistribution:
    height, slope, sun_slope, distance = case
    medium = MEDIA[name](extinction, 100.0)
    return FlightDistribution(medium, torch.tensor(height, dtype=torch.float64), slope, sun_slope, distance)


def extinction_matters(case: tuple) -> bool:
    """Whether the distribution depends on it: looking at the sun, light arrives alike from all depths."""
    return case[2] is None or abs(case[1] - case[2]) > 1e-6


def by_quadrature(distribution: FlightDistribution, low: float, high: float) -> float:
    """Integral of the density between two distances."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    t = torch.from_numpy(low + 0.5 * (high - low) * (nodes + 1.0))
    return float(distribution.evaluate_pdf(t).numpy() @ weights * 0.5 * (high - low))


@pytest.mark.parametrize("name", MEDIA)
@pytest.mark.parametrize("case", CASES)
def test_the_cdf_is_the_integral_of_the_pdf(name: str, case: tuple) -> None:
    distribution = flight(name, case)
    edges = distribution.invert_cdf(torch.tensor([0.0, 0.1, 0.5, 0.9], dtype=torch.float64)).tolist()
    for number, (low, high) in enumerate(itertools.pairwise(edges)):
        expected = (0.1, 0.4, 0.4)[number]
        assert by_quadrature(distribution, low, high) == pytest.approx(expected, rel=1e-9)
        difference = distribution.evaluate_cdf(high) - distribution.evaluate_cdf(low)
        assert difference.item() == pytest.approx(expected, rel=1e-9)
    assert distribution.evaluate_cdf(math.inf).item() == pytest.approx(1.0, rel=1e-12)
    assert distribution.evaluate_cdf(edges[0]).item() == 0.0
    assert distribution.evaluate_pdf(case[3] * 1.01 + 1.0).item() == 0.0
    if extinction_matters(case):
        assert by_quadrature(flight(name, case, extinction=0.026), edges[1], edges[2]) != pytest.approx(0.4, rel=1e-3)


@pytest.mark.parametrize("name", MEDIA)
@pytest.mark.parametrize("case", CASES)
def test_the_density_of_arriving_light_is_what_is_scattered(name: str, case: tuple) -> None:
    """sigma exp(-tau - A) over S, each from the other file."""
    height, slope, sun_slope, distance = case
    if sun_slope is None:
        return
    distribution = flight(name, case)
    t = distribution.invert_cdf(torch.tensor([0.2, 0.6], dtype=torch.float64))
    whole = compute_in_scattering(distribution.medium, distribution.height, slope, sun_slope, distance)
    below = compute_in_scattering(distribution.medium, distribution.height, slope, sun_slope, t)
    torch.testing.assert_close(below / whole, torch.tensor([0.2, 0.6], dtype=torch.float64), rtol=1e-9, atol=0.0)
    if slope:
        collisions = flight(name, (height, slope, None, distance)).evaluate_cdf(t)
        assert (collisions / (below / whole) - 1.0).abs().max() > 1e-3


@pytest.mark.parametrize("name", MEDIA)
@pytest.mark.parametrize("case", CASES)
def test_samples_follow_the_density(name: str, case: tuple) -> None:
    distribution = flight(name, case)
    samples = distribution.sample_distance((SAMPLES,), torch.Generator().manual_seed(5))
    edges = distribution.invert_cdf(torch.linspace(0.0, 1.0, BINS + 1, dtype=torch.float64))
    inner = np.concatenate([edges.numpy()[:-1], [np.inf]])
    expected = np.array(
        [by_quadrature(distribution, a, b) for a, b in zip(edges[:-2].tolist(), edges[1:-1].tolist(), strict=True)]
    )
    expected = np.append(expected, 1.0 - expected.sum()) * SAMPLES
    counts = np.histogram(samples.numpy(), inner)[0]
    assert counts.sum() == SAMPLES
    assert histogram_p_value(counts, expected) > FALSE_ALARM
    if extinction_matters(case):
        other = flight(name, case, extinction=0.026)
        wrong = np.diff(np.append(other.evaluate_cdf(edges[:-1]).numpy(), 1.0)) * SAMPLES
        assert histogram_p_value(counts, wrong) < FALSE_ALARM


@pytest.mark.parametrize("name", MEDIA)
def test_the_inverse_is_accurate_for_thin_and_thick_fog(name: str) -> None:
    u = torch.tensor([1e-9, 1e-3, 0.5, 0.999, 1.0], dtype=torch.float64)
    for extinction in (1e-10, 1e-5, 1.0, 100.0):
        for case in CASES:
            distribution = flight(name, case, extinction)
            t = distribution.invert_cdf(u)
            if math.isinf(case[3]):
                assert not torch.isnan(t).any()
            else:
                assert (t <= case[3]).all()
            again = distribution.evaluate_cdf(t[:-1])
            # A distance behind 100 m of clear air, or at the far end of thick fog, is only as good as its rounding.
            slack = 1e-9 + distribution.evaluate_pdf(t[:-1]) * (200.0 + t[:-1]) * 1e-15 / u[:-1]
            assert ((again / u[:-1] - 1.0).abs() <= slack).all() or bool(
                (distribution.evaluate_cdf(math.inf) == 0.0).all()
            )


def test_nothing_happens_without_fog_or_light() -> None:
    u = torch.rand(5, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    for case in ((200.0, 0.5, None, math.inf), (30.0, 0.2, 0.0, 10.0), (30.0, 0.2, 0.5, 0.0)):
        distribution = flight("uniform", case)
        assert (distribution.invert_cdf(u) == math.inf).all()
        assert distribution.evaluate_cdf(7.0).item() == 0.0
        assert distribution.evaluate_pdf(7.0).item() == 0.0
    empty = flight("linear", (30.0, 0.2, None, 50.0), extinction=0.0)
    assert (empty.invert_cdf(u) == math.inf).all()


@pytest.mark.parametrize("name", MEDIA)
def test_samples_have_gradients(name: str) -> None:
    def flown(extinction: torch.Tensor, height: torch.Tensor, slope: torch.Tensor) -> torch.Tensor:
        u = torch.tensor([0.1, 0.7], dtype=torch.float64)
        return FlightDistribution(MEDIA[name](extinction, 100.0), height, slope, 0.3, 70.0).invert_cdf(u)

    values = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.02, 30.0, 0.2)]
    assert torch.autograd.gradcheck(flown, values, rtol=1e-5)


def test_equal_seeds_give_equal_samples() -> None:
    distribution = flight("linear", CASES[0])
    first, second, other = (distribution.sample_distance((9,), torch.Generator().manual_seed(s)) for s in (1, 1, 2))
    assert torch.equal(first, second)
    assert not torch.equal(first, other)
