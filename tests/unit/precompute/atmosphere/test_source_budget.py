"""The budget: tolerances are met, orders are counted, and the report says so."""

import dataclasses
import math

import pytest
import torch

from precompute.atmosphere import source_budget
from precompute.atmosphere.source_budget import build_source_function, sizes_for
from precompute.atmosphere.source_function import SourceSizes
from render.atmosphere.earth import earth
from render.atmosphere.sun_columns import build_sun_columns
from render.errors import ParameterError
from tests.support.planets import uniform_air

TINY = SourceSizes(5, 9, 7, 5, 4, 6, 4, 4)


@pytest.fixture(autouse=True)
def _coarse_sunlight(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_budget, "build_sun_columns", lambda shells: build_sun_columns(shells, 16, 48))


def test_a_loose_tolerance_is_met_and_a_looser_one_is_cheaper(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_budget, "SourceSizes", lambda: TINY)
    planet = earth((550e-9,))
    built, report = build_source_function(planet, tolerance=0.05)
    assert report.met
    assert report.error is not None
    assert report.error <= 0.05
    assert report.orders == built.orders > 2
    assert report.remainder <= 0.025
    _, looser = build_source_function(planet, tolerance=0.5)
    assert looser.orders <= report.orders
    assert looser.sizes.suns <= report.sizes.suns
    assert (looser.orders, looser.sizes) != (report.orders, report.sizes)


def test_given_sizes_and_orders_are_taken() -> None:
    stages: list[str] = []
    built, report = build_source_function(
        earth((440e-9,)), sizes=TINY, orders=3, on_progress=lambda stage, share: stages.append(stage)
    )
    assert (report.sizes, report.orders, built.orders, report.error) == (TINY, 3, 3, None)
    assert built.source.shape == (5, 9, 7, 5, 2)
    assert len(stages) == 2
    four, more = build_source_function(earth((440e-9,)), sizes=TINY, orders=4)
    assert more.remainder < report.remainder
    assert float(four.source.sum()) > float(built.source.sum())


def test_a_tolerance_beyond_reach_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_budget, "SourceSizes", lambda: TINY)
    monkeypatch.setattr(source_budget, "FINEST", 0.75)
    _, report = build_source_function(earth((550e-9,)), tolerance=1e-6, orders=2)
    assert not report.met
    assert report.error is not None
    assert report.error > 1e-6


def test_the_degree_follows_the_lobe() -> None:
    planet = earth()
    degrees = [sizes_for(dataclasses.replace(planet, mie_asymmetry=g), 0.01).degree for g in (0.0, 0.5, 0.8)]
    assert degrees == sorted(degrees)
    assert degrees[0] >= 2
    assert sizes_for(planet, 1e-4).degree > sizes_for(planet, 1e-2).degree


def test_no_air_sends_no_light() -> None:
    built, report = build_source_function(uniform_air(0.0), sizes=TINY)
    assert report.orders == 2
    assert report.remainder == 0.0
    assert float(built.source.abs().max()) == 0.0


def test_thick_aerosol_needs_many_orders() -> None:
    planet = earth((550e-9,))
    clear = build_source_function(planet, sizes=TINY, tolerance=0.02)[1]
    built, thick = build_source_function(planet.with_aerosol(60.0), sizes=TINY, tolerance=0.02)
    assert thick.orders > clear.orders
    assert bool(torch.isfinite(built.source).all())


@pytest.mark.parametrize("tolerance", [0.0, -1.0, math.nan])
def test_a_tolerance_that_is_none_is_refused(tolerance: float) -> None:
    with pytest.raises(ParameterError, match="tolerance"):
        build_source_function(earth(), tolerance=tolerance)


def test_one_order_is_refused() -> None:
    with pytest.raises(ParameterError, match="two orders"):
        build_source_function(earth(), orders=1)
