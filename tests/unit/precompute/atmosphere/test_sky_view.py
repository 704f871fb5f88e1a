"""The table of a camera against the integrals along single rays."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from precompute.atmosphere.sky_view import build_sky_view
from render.atmosphere.accurate_sky import compute_light_to_point, compute_sky_light
from render.atmosphere.ray_geometry import safe_sqrt, sine_from_cosine
from render.atmosphere.sky_view import horizon_angle, look_up_sky_view
from render.camera import direction_from_angles
from render.errors import ParameterError
from tests.support.planets import golden
from tests.support.skies import coarse_source

SOURCE = coarse_source()


def sun_at(elevation: float, azimuth: float = 30.0) -> Tensor:
    """Unit vector towards the sun, from degrees."""
    return torch.tensor(direction_from_angles(math.radians(azimuth), math.radians(elevation)), dtype=torch.float64)


def directions(altitude: float, count: int = 300) -> Tensor:
    """All around, and as many within some degrees of the horizon."""
    generator = torch.Generator().manual_seed(1)
    anywhere = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=-1)
    near, turn = torch.randn(2, count, generator=generator, dtype=torch.float64)
    angle, turn = horizon_angle(SOURCE.atmosphere, altitude) + 0.03 * near, 2.0 * math.pi * turn
    parts = (torch.sin(angle) * torch.sin(turn), torch.sin(angle) * torch.cos(turn), torch.cos(angle))
    return torch.cat([anywhere, torch.stack(parts, -1)])


def errors(altitude: float, elevation: float, sizes: tuple[int, int] | None = None) -> Tensor:
    """Relative errors where there is at least a thousandth of the largest light."""
    sun, view = sun_at(elevation), directions(altitude)
    table = build_sky_view(SOURCE, altitude, sun, sizes=sizes)
    exact = compute_sky_light(SOURCE, table.eye, view, sun).radiance
    lit = exact > 1e-3 * exact.max()
    return (look_up_sky_view(table, view)[0].radiance[lit] / exact[lit] - 1.0).abs()


@pytest.mark.parametrize(
    ("altitude", "elevation", "median", "most"),
    [(2.0, 50.0, 2e-4, 5e-3), (2.0, -4.0, 4e-4, 5e-3), (9000.0, 3.0, 4e-4, 2e-3)],
)
def test_it_is_that_of_single_rays(altitude: float, elevation: float, median: float, most: float) -> None:
    found = errors(altitude, elevation)
    assert float(found.median()) < median
    assert float(found.quantile(0.95)) < most
    rough = errors(altitude, elevation, (24, 12))
    assert float(rough.median()) > 3.0 * float(found.median())


@pytest.mark.parametrize("altitude", [1.0, 1000.0, 9000.0])
def test_light_scattered_once_is_the_exact_one(altitude: float) -> None:
    """Converged integrals of the golden data, above and below the horizon."""
    rows = golden("sky_radiance")
    chosen = (rows["sun_zenith_deg"] == 60.0) & (rows["altitude_m"] == altitude)
    cos_view, cos_sun, cos_view_sun = (torch.from_numpy(rows[name][chosen]) for name in ("mu", "mu_s", "nu"))
    sun = torch.stack([torch.zeros(()).double(), sine_from_cosine(cos_sun[0]), cos_sun[0]])
    ahead = (cos_view_sun - cos_view * cos_sun) / sun[1]
    side = safe_sqrt(1.0 - cos_view.square() - ahead.square())
    table = build_sky_view(SOURCE, altitude, sun)
    once = table.light.clone()
    once[..., 6:] = 0.0
    found = look_up_sky_view(replace(table, light=once), torch.stack([side, ahead, cos_view], -1))[0].radiance
    error = (found / torch.from_numpy(rows["L_order1_exact"][chosen]) - 1.0).abs()
    assert len(error) > 20
    assert float(error.median()) < 3e-4
    assert float(error.max()) < 2e-3
    theirs = np.abs(rows["L_order1"][chosen] / rows["L_order1_exact"][chosen] - 1.0)
    assert float(theirs.max()) > 5.0 * float(error.max())


def test_from_space_rays_pass_the_air_by() -> None:
    sun, altitude = sun_at(40.0), 400_000.0
    table = build_sky_view(SOURCE, altitude, sun, sizes=(96, 48))
    view = directions(altitude)
    seen, ground = look_up_sky_view(table, view)
    exact = compute_sky_light(SOURCE, table.eye, view, sun)
    missed = (exact.transmittance == 1.0).all(-1)
    assert bool(missed.any() & ground.any() & ~(missed & ground).any())
    assert bool((seen.radiance[missed] == 0.0).all() & (seen.transmittance[missed] == 1.0).all())
    lit = exact.radiance > 0.01 * exact.radiance.max()
    error = (seen.radiance[lit] / exact.radiance[lit] - 1.0).abs()
    assert float(error.median()) < 1e-3
    torch.testing.assert_close(seen.transmittance[~ground], exact.transmittance[~ground], rtol=0.0, atol=0.02)


def test_a_reach_ends_the_air() -> None:
    sun, view, reach = sun_at(20.0), directions(100.0), 8000.0
    view = view[view[:, 2] > 0.01]
    table = build_sky_view(SOURCE, 100.0, sun, reach=reach)
    seen, ground = look_up_sky_view(table, view)
    assert not bool(ground.any())
    exact = compute_light_to_point(SOURCE, table.eye, table.eye + reach * view, sun)
    torch.testing.assert_close(seen.radiance, exact.radiance, rtol=2e-3, atol=1e-5)
    torch.testing.assert_close(seen.transmittance, exact.transmittance, rtol=0.0, atol=1e-3)
    whole = look_up_sky_view(build_sky_view(SOURCE, 100.0, sun), view)[0]
    assert bool((whole.radiance > 1.2 * seen.radiance).all())


def test_the_sun_in_the_zenith_has_no_azimuth() -> None:
    table = build_sky_view(SOURCE, 0.0, torch.tensor([0.0, 0.0, 1.0]), sizes=(24, 12))
    torch.testing.assert_close(table.light, table.light[:, :1].expand_as(table.light), rtol=1e-6, atol=1e-9)


def test_impossible_views_are_refused() -> None:
    sun = sun_at(40.0)
    with pytest.raises(ParameterError, match="on the ground or above"):
        build_sky_view(SOURCE, -1.0, sun)
    with pytest.raises(ParameterError, match="positive distance"):
        build_sky_view(SOURCE, 0.0, sun, reach=0.0)
    with pytest.raises(ParameterError, match="two nodes"):
        build_sky_view(SOURCE, 0.0, sun, sizes=(1, 8))
    with pytest.raises(ParameterError, match="direction"):
        build_sky_view(SOURCE, 0.0, torch.zeros(3))
