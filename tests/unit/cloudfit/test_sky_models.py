"""Both models of the sky behind one face."""

import math
from pathlib import Path

import pytest
import torch

from cloudfit import sky_models
from cloudfit.sky_models import AccurateSky, SkyModel, TabulatedSky, prepare_sky
from precompute.atmosphere import sky_view
from precompute.atmosphere_tables import TablePlan
from render.atmosphere.earth import earth
from render.atmosphere.tables import TableSizes
from render.errors import ParameterError
from tests.support.atmospheres import small_states
from tests.support.skies import coarse_source

ACCURATE, TABULATED = AccurateSky(coarse_source()), TabulatedSky(small_states()[1].tables(earth()))
SUN = torch.tensor([0.0, math.cos(0.7), math.sin(0.7)], dtype=torch.float64)
VIEW = torch.nn.functional.normalize(
    torch.tensor([[0.5, 0.2, 0.5], [-0.7, 0.0, 0.3], [0.0, -0.5, 0.9]], dtype=torch.float64), dim=-1
)


@pytest.fixture(autouse=True)
def coarse_views(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sky_view, "LOW", (32, 24))


def test_the_models_agree_about_the_sky() -> None:
    accurate, tabulated = (model.compose(100.0, VIEW, SUN) for model in (ACCURATE, TABULATED))
    torch.testing.assert_close(tabulated, accurate, rtol=0.15, atol=0.0)
    assert not torch.allclose(tabulated, accurate, rtol=1e-4)
    assert not torch.allclose(ACCURATE.compose(9000.0, VIEW, SUN), accurate, rtol=0.1)


@pytest.mark.parametrize("model", [ACCURATE, TABULATED])
def test_air_in_front_of_a_cloud(model: SkyModel) -> None:
    near, far = (model.light_up_to(distance, 100.0, VIEW, SUN) for distance in (1000.0, 10_000.0))
    assert bool((far.radiance > near.radiance).all() & (near.radiance > 0.0).all())
    assert bool((far.transmittance < near.transmittance).all() & (near.transmittance < 1.0).all())
    sky = model.compose(100.0, VIEW, SUN)
    assert bool((far.radiance < sky).all())


@pytest.mark.parametrize("model", [ACCURATE, TABULATED])
def test_light_at_a_height(model: SkyModel) -> None:
    low_sun, low_around = model.light_at(0.0, SUN)
    high_sun, high_around = model.light_at(8000.0, SUN)
    solar = torch.tensor(earth().solar_irradiance, dtype=torch.float64)
    assert bool(((low_sun < high_sun) & (high_sun < solar)).all())
    assert bool((low_around > 0.0).all() & (math.pi * low_around < low_sun).all())
    assert float(high_around[2] / low_around[2]) == pytest.approx(1.0, abs=0.5)
    assert float(low_sun[2] / low_sun[0]) < float(high_sun[2] / high_sun[0]), "the lower, the redder"


def test_the_models_agree_about_light() -> None:
    """Of the irradiance in the tables the last order is missing; the light from below is taken for that of the ground."""
    more = TabulatedSky(small_states()[2].tables(earth()))
    for accurate, tabulated in zip(ACCURATE.light_at(500.0, SUN), more.light_at(500.0, SUN), strict=True):
        torch.testing.assert_close(tabulated, accurate, rtol=0.13, atol=0.0)
    assert not torch.allclose(TABULATED.light_at(500.0, SUN)[1], ACCURATE.light_at(500.0, SUN)[1], rtol=0.13)


@pytest.mark.parametrize("mode", ["accurate", "parity"])
def test_a_model_is_kept(mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sky_models.TOLERANCES, "draft", 10.0)
    monkeypatch.setitem(sky_models.PLANS, "draft", TablePlan(sizes=TableSizes(8, 32, 4, 8, 4, 16, 3, 8), orders=2))
    planet = earth((550e-9,))
    model, first = prepare_sky(mode, planet, "draft", tmp_path)
    again, second = prepare_sky(mode, planet, "draft", tmp_path)
    assert (first.reused, second.reused) == (False, True)
    assert first.path == second.path is not None
    assert model.atmosphere == again.atmosphere == planet
    assert torch.equal(model.compose(2.0, VIEW, SUN), again.compose(2.0, VIEW, SUN))


def test_unknown_names_are_refused() -> None:
    for mode, quality in (("exact", "draft"), ("parity", "best")):
        with pytest.raises(ParameterError, match=r"accurate, parity.*draft, standard, reference"):
            prepare_sky(mode, earth(), quality, None)
