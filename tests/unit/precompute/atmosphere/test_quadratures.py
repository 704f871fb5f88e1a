"""Quadrature rules: weights that sum to one, the polynomials each is exact for, and their order of convergence."""

import math

import pytest
import torch

from precompute.atmosphere.quadratures import PARITY, RULES, DirectionRule, LineRule, Quadratures
from render.errors import ParameterError


@pytest.mark.parametrize("name", RULES)
def test_constants_and_lines_are_exact_and_curves_converge(name: str) -> None:
    def integral(count: int, power: int) -> float:
        positions, weights = LineRule(name, count).nodes()
        assert bool(((positions >= 0.0) & (positions <= 1.0)).all())
        return float((weights * positions**power).sum())

    assert integral(7, 0) == pytest.approx(1.0, abs=1e-14)
    assert integral(7, 1) == pytest.approx(0.5, abs=1e-14)
    assert integral(7, 1) != pytest.approx(0.45, abs=1e-3)
    coarse, fine = abs(integral(8, 6) - 1 / 7), abs(integral(16, 6) - 1 / 7)
    assert fine < 0.3 * coarse or coarse < 1e-14


def test_gauss_and_legendre_are_exact_far_beyond_the_others() -> None:
    positions, weights = LineRule("gauss_legendre", 4).nodes()
    assert float((weights * positions**7).sum()) == pytest.approx(1.0 / 8.0, abs=1e-15)
    assert float((weights * positions**9).sum()) != pytest.approx(1.0 / 10.0, abs=1e-7)


def test_directions_cover_the_sphere() -> None:
    for rule in (PARITY.scattering_density, DirectionRule(LineRule("gauss_legendre", 8), LineRule("midpoint", 4))):
        angles, weights = rule.polar_nodes(math.pi)
        azimuths, shares = rule.azimuth_nodes()
        total = float(weights.sum() * shares.sum())
        assert total == pytest.approx(4.0 * math.pi, rel=2e-3)
        assert float((weights * torch.cos(angles)).sum()) == pytest.approx(0.0, abs=1e-12)
        assert float((shares * torch.cos(azimuths)).sum()) == pytest.approx(0.0, abs=1e-12)
    assert total != pytest.approx(2.0 * math.pi, rel=0.1)


def test_the_rules_of_the_reference() -> None:
    assert Quadratures() == PARITY
    angles, _ = PARITY.scattering_density.polar_nodes(math.pi)
    assert math.degrees(float(angles[7])) == pytest.approx(84.375)
    assert len(PARITY.transmittance.nodes()[0]) == 501
    weights = PARITY.single_scattering.nodes()[1]
    assert float(weights[0]) == float(weights[-1]) == pytest.approx(0.01)
    assert float(weights[25]) == pytest.approx(0.02)


def test_unknown_rules_are_refused() -> None:
    with pytest.raises(ParameterError, match="trapezoid"):
        LineRule("simpson", 4)
    with pytest.raises(ParameterError, match="at least one"):
        LineRule("midpoint", 0)
