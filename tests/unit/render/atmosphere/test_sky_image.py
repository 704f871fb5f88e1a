"""Pictures of the sky: the sun's disc, the ground's light, directions all around, and how they are shown."""

import math

import pytest
import torch

from render.atmosphere.earth import earth
from render.atmosphere.sky import look_up_sky_radiance, look_up_surface_irradiance, solar_radiance
from render.atmosphere.sky_image import choose_white, colour_sky, compose_sky, panorama_directions, show_sky
from render.errors import ParameterError
from tests.support.atmospheres import small_states, tensor

TABLES = small_states()[-1].tables(earth())
BOTTOM = earth().bottom_radius
UP = tensor(0.0, 0.0, 1.0)


def tilted(angle: float) -> torch.Tensor:
    """Direction at an angle from the zenith [rad], towards north."""
    return tensor(0.0, math.sin(angle), math.cos(angle))


def test_the_sun_is_as_wide_as_it_is_and_dimmed_by_the_air() -> None:
    alpha = earth().sun_angular_radius
    sun = tilted(0.5)
    inside, outside = (compose_sky(TABLES, 0.0, tilted(0.5 + x * alpha)[None], sun)[0] for x in (0.99, 1.01))
    disc = inside - outside
    seen = look_up_sky_radiance(TABLES, tensor(0.0, 0.0, BOTTOM), sun, sun)
    torch.testing.assert_close(disc, solar_radiance(earth()) * seen.transmittance, rtol=1e-3, atol=0.0)
    assert float((disc / solar_radiance(earth())).max()) < 1.0


def test_the_ground_reflects_what_falls_on_it() -> None:
    """Straight down from the ground itself there is no air in between."""
    sun = tilted(0.7)
    found = compose_sky(TABLES, 0.0, -UP[None], sun)[0]
    lit = look_up_surface_irradiance(TABLES, tensor(0.0, 0.0, BOTTOM), UP, sun)
    torch.testing.assert_close(found, 0.1 / math.pi * (lit.sun + lit.sky), rtol=1e-6, atol=1e-9)
    assert not torch.allclose(found, 0.1 / math.pi * lit.sun, rtol=1e-3)


def test_the_ground_fades_behind_the_air() -> None:
    sun = tilted(0.7)
    low, high = (compose_sky(TABLES, altitude, -UP[None], sun)[0] for altitude in (0.0, 1e6))
    air = look_up_sky_radiance(TABLES, tensor(0.0, 0.0, BOTTOM + 1e6), -UP, sun).radiance
    ground = high - air
    assert bool((ground < low).all() & (ground > 0.3 * low).all())
    assert float(high[2] / high[0]) > float(low[2] / low[0])


def test_all_around() -> None:
    directions = panorama_directions(8, 4).reshape(4, 8, 3)
    torch.testing.assert_close(directions.norm(dim=-1), torch.ones(4, 8, dtype=torch.float64))
    assert bool((directions[0, :, 2] > directions[1, :, 2]).all())
    east_of_north = directions[1, 0]
    assert float(east_of_north[0]) > 0.0
    assert float(east_of_north[1]) > 0.0
    assert float(directions[1, 7, 0]) < 0.0


def test_noon_is_blue_and_what_is_shown_fits_the_display() -> None:
    view = panorama_directions(16, 8)
    rgb = colour_sky(earth(), compose_sky(TABLES, 0.0, view, tilted(0.3)))
    sky = rgb.reshape(8, 16, 3)[2]
    assert bool((sky[:, 2] > sky[:, 0]).all())
    white = choose_white(rgb)
    shown = show_sky(rgb, white)
    assert shown.dtype == torch.float32
    assert bool(((shown >= 0.0) & (shown <= 1.0)).all())
    assert float(show_sky(rgb, white, 1.0).mean()) > float(shown.mean())
    torch.testing.assert_close(show_sky(rgb, white, 1.0), show_sky(rgb, 0.5 * white))
    assert choose_white(torch.zeros(5, 3)) == 1.0


def test_impossible_pictures_are_refused() -> None:
    for altitude in (-1.0, math.nan, math.inf):
        with pytest.raises(ParameterError, match="on the ground or above"):
            compose_sky(TABLES, altitude, UP[None], UP)
    for white, exposure in ((0.0, 0.0), (math.nan, 0.0), (1.0, math.inf)):
        with pytest.raises(ParameterError, match="white"):
            show_sky(torch.ones(1, 3), white, exposure)
