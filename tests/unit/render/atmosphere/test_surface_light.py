"""Light on sloping surfaces, against the source function's own irradiance and closed forms."""

import math

import torch

from precompute.atmosphere.sky_view import build_sky_view
from render.atmosphere.ground_light import look_up_ground_irradiance, look_up_ground_radiance
from render.atmosphere.sky_view import SkyView
from render.atmosphere.surface_light import compute_surface_irradiance
from tests.support.skies import coarse_source

SOURCE = coarse_source()
SUN = torch.tensor([0.0, math.cos(0.7), math.sin(0.7)], dtype=torch.float64)
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
NORTH = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)


def even_sky(radiance: float) -> SkyView:
    """A view from the ground in which all of the sky is equally bright."""
    light = torch.zeros(8, 4, 9, dtype=torch.float64)
    light[:4, :, 6:] = radiance
    return SkyView(SOURCE, 0.0, SUN, light, torch.ones(8, 3, dtype=torch.float64))


def test_an_even_sky_has_closed_forms() -> None:
    """pi L on level ground, half of it on a wall, (1 + cos) / 2 in between."""
    slope = torch.tensor([0.0, 0.4, math.pi / 2, math.pi], dtype=torch.float64)
    normal = torch.sin(slope)[:, None] * NORTH + torch.cos(slope)[:, None] * UP
    found = compute_surface_irradiance(even_sky(2.0), normal)
    exact = 2.0 * math.pi * 0.5 * (1.0 + torch.cos(slope))
    torch.testing.assert_close(found.sky[:, 0], exact, rtol=1e-3, atol=1e-9)
    reflected = math.pi * look_up_ground_radiance(SOURCE, SUN[2])
    torch.testing.assert_close(found.ground[3], reflected, rtol=1e-3, atol=0.0)
    torch.testing.assert_close(found.ground[2], 0.5 * reflected, rtol=1e-3, atol=0.0)
    assert float(found.ground[0].max()) == 0.0


def test_level_ground_gets_what_the_source_function_says() -> None:
    """The sources hold light scattered twice; the irradiance of the ground, which only counts one, is made without it."""
    view = build_sky_view(SOURCE, 0.0, SUN)
    wavelengths = len(SOURCE.atmosphere.wavelengths)
    once = view.light.clone()
    once[..., 2 * wavelengths :] = 0.0
    found = compute_surface_irradiance(SkyView(SOURCE, 0.0, SUN, once, view.transmittance), UP[None])
    expected = look_up_ground_irradiance(SOURCE, SUN[2])
    torch.testing.assert_close(found.sky[0], expected.sky, rtol=0.02, atol=0.0)
    torch.testing.assert_close(found.sun[0], expected.sun, rtol=1e-3, atol=0.0)
    both = compute_surface_irradiance(view, UP[None])
    assert bool((both.sky[0] > 1.02 * expected.sky).all())


def test_the_slope_towards_the_sun_gets_more() -> None:
    view = build_sky_view(SOURCE, 3000.0, SUN, sizes=(48, 32))
    towards, away = compute_surface_irradiance(view, torch.stack([NORTH, -NORTH])).sky
    assert bool((towards > 1.05 * away).all())
    facing = compute_surface_irradiance(view, torch.stack([SUN, UP, -SUN])).sun
    torch.testing.assert_close(facing[1], facing[0] * SUN[2])
    assert float(facing[2].abs().max()) == 0.0


def test_beyond_the_air_the_sun_sets_behind_the_planet() -> None:
    """From 400 km the planet's edge is 19.8 degrees below the level, and the air's 18.2."""
    solar = torch.tensor(SOURCE.atmosphere.solar_irradiance, dtype=torch.float64)
    seen = []
    for below in (10.0, 19.6, 21.0):
        angle = math.radians(below)
        sun = torch.tensor([0.0, math.cos(angle), -math.sin(angle)], dtype=torch.float64)
        view = build_sky_view(SOURCE, 400_000.0, sun, sizes=(8, 4))
        seen.append(compute_surface_irradiance(view, sun[None]).sun[0] / solar)
    torch.testing.assert_close(seen[0], torch.ones(3, dtype=torch.float64))
    assert bool(((seen[1] > 0.0) & (seen[1] < 0.99)).all())
    assert float(seen[2].max()) == 0.0
