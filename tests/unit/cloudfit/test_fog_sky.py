"""An atmosphere in the units of a fog picture."""

import math
from dataclasses import replace

import pytest
import torch

from cloudfit.fog_sky import compose_fog_sky
from cloudfit.sky_models import AccurateSky
from precompute.atmosphere import sky_view
from render.atmosphere.sky_image import panorama_directions
from render.atmosphere.spectral_colour import convert_to_linear_srgb, convert_to_luminance
from tests.support.skies import coarse_source

MODEL = AccurateSky(coarse_source())
VIEW = panorama_directions(16, 8).reshape(8, 16, 3)


@pytest.fixture(autouse=True)
def coarse_views(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sky_view, "LOW", (32, 24))
    monkeypatch.setattr(sky_view, "HIGH", (32, 24))


def sun(elevation: float) -> torch.Tensor:
    angle = math.radians(elevation)
    return torch.tensor([0.1 * math.cos(angle), math.sqrt(0.99) * math.cos(angle), math.sin(angle)]).double()


def test_a_white_surface_is_nearly_one_above_the_air() -> None:
    wavelengths, solar = MODEL.atmosphere.wavelengths, torch.tensor(MODEL.atmosphere.solar_irradiance).double()
    white = convert_to_linear_srgb(solar, wavelengths) / convert_to_luminance(solar, wavelengths)
    high = compose_fog_sky(MODEL, 59_999.0, VIEW, sun(60.0)).sunlight
    torch.testing.assert_close(high, white, rtol=1e-3, atol=0.0)
    low = compose_fog_sky(MODEL, 2.0, VIEW, sun(60.0)).sunlight
    assert bool((low < 0.95 * white).all() & (low > 0.4 * white).all())


def test_sky_and_ambient_light_are_in_the_same_unit() -> None:
    """The ambient light is the mean of what is seen all around, but for the disc of the sun."""
    towards = sun(50.0)
    found = compose_fog_sky(MODEL, 2.0, VIEW, towards)
    assert found.radiance.shape == (8, 16, 3)
    assert bool((VIEW.reshape(-1, 3) @ towards < math.cos(MODEL.atmosphere.sun_angular_radius)).all())
    weight = (1.0 - VIEW[..., 2:].square()).sqrt() * VIEW[..., 2:].abs()
    mean = (weight * found.radiance).sum((0, 1)) / weight.sum()
    torch.testing.assert_close(mean, found.ambient, rtol=0.15, atol=0.0)
    assert not torch.allclose(math.pi * mean, found.ambient, rtol=0.15)


def test_dusk_is_dim_and_red() -> None:
    day, dusk = (compose_fog_sky(MODEL, 2.0, VIEW, sun(elevation)) for elevation in (40.0, 1.0))
    assert bool((dusk.ambient < day.ambient).all())
    assert float(dusk.sunlight[2] / dusk.sunlight[0]) < 0.5 * float(day.sunlight[2] / day.sunlight[0])
    dark = replace(dusk, sunlight=compose_fog_sky(MODEL, 2.0, VIEW, sun(-5.0)).sunlight)
    assert float(dark.sunlight.max()) == 0.0
