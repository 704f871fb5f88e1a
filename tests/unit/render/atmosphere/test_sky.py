"""Look-ups of the sky against the reference, and at the ends of the world: ground, top, horizon, sunset, space."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from precompute.atmosphere_tables import TablePlan, build_atmosphere_tables
from render.atmosphere.earth import earth
from render.atmosphere.sky import (
    AirLight,
    look_up_radiance_to_point,
    look_up_sky_radiance,
    look_up_surface_irradiance,
    solar_radiance,
)
from render.atmosphere.tables import AtmosphereTables, TableSizes
from render.errors import ParameterError
from tests.support.atmospheres import PARITY, golden, peak_error, small_states, tensor

BOTTOM, TOP = earth().bottom_radius, earth().top_radius


def small_tables(orders: int = 4) -> AtmosphereTables:
    return small_states()[orders - 1].tables(earth())


def sky_of(data: dict[str, np.ndarray], turned: float = 1.0) -> AirLight:
    camera, view, sun = (torch.from_numpy(data[name]) for name in ("camera_m", "view", "sun"))
    shadow = torch.from_numpy(data["shadow_length_m"]) if "shadow_length_m" in data else 0.0
    return look_up_sky_radiance(small_tables(), camera, view, turned * sun, shadow)


def test_sky_radiance_of_the_reference() -> None:
    data = golden("sky_radiance")
    assert peak_error(sky_of(data).radiance, data["L_orders1_4_small"]) < PARITY
    assert peak_error(sky_of(data, -1.0).radiance, data["L_orders1_4_small"]) > 0.1


def test_shadows_and_cameras_in_space_of_the_reference() -> None:
    data = golden("sky_radiance_extra")
    found = sky_of(data)
    assert peak_error(found.radiance, data["L_orders1_4_small"]) < PARITY
    assert peak_error(found.transmittance, data["transmittance_small"]) < PARITY
    unshaded = sky_of({**data, "shadow_length_m": 0.0 * data["shadow_length_m"]})
    assert peak_error(unshaded.radiance, data["L_orders1_4_small"]) > 1e-3
    misses = (data["transmittance_small"] == 1.0).all(-1)
    assert misses.any()
    assert float(found.radiance[torch.from_numpy(misses)].abs().max()) == 0.0


def test_aerial_perspective_of_the_reference() -> None:
    data = golden("aerial_perspective")
    names = ("camera_m", "point_m", "sun", "shadow_length_m")
    arguments = [torch.from_numpy(data[name]) for name in names]
    found = look_up_radiance_to_point(small_tables(), *arguments)
    for kind in ("pair", "shadow", "space"):
        rows = data["kind"] == kind
        assert peak_error(found.radiance[torch.from_numpy(rows)], data["inscatter_orders1_4_small"][rows]) < PARITY
        assert peak_error(found.transmittance[torch.from_numpy(rows)], data["transmittance_small"][rows]) < PARITY
    unshaded = look_up_radiance_to_point(small_tables(), *arguments[:3])
    assert peak_error(unshaded.radiance, data["inscatter_orders1_4_small"]) > 1e-3


def test_irradiance_of_the_reference() -> None:
    data = golden("irradiance")
    point, normal, sun = (torch.from_numpy(data[name]) for name in ("point_m", "normal", "sun"))
    found = look_up_surface_irradiance(small_tables(), point, normal, sun)
    assert peak_error(found.sun, data["sun_irradiance_small"]) < PARITY
    assert peak_error(found.sky, data["sky_init4_small"]) < PARITY
    assert (
        peak_error(look_up_surface_irradiance(small_tables(3), point, normal, sun).sky, data["sky_init4_small"]) > 1e-3
    )
    assert (
        peak_error(look_up_surface_irradiance(small_tables(), point, -normal, sun).sun, data["sun_irradiance_small"])
        > 0.1
    )


def test_the_sun_radiates_its_irradiance() -> None:
    solid_angle = math.pi * earth().sun_angular_radius ** 2
    torch.testing.assert_close(solar_radiance(earth()) * solid_angle, tensor(*earth().solar_irradiance))


def directions(elevation: Tensor, azimuth: float = 0.0) -> Tensor:
    """Unit vectors `(..., 3)` at elevations [rad] above the horizontal of a camera on the z axis."""
    level = torch.cos(elevation)
    return torch.stack([level * math.cos(azimuth), level * math.sin(azimuth), torch.sin(elevation)], -1)


@pytest.fixture(scope="module", params=[1.0, 100.0], ids=["clear", "aerosol x 100"])
def sweep_tables(request: pytest.FixtureRequest) -> AtmosphereTables:
    plan = TablePlan(sizes=TableSizes(32, 128, 8, 32, 8, 32, 4, 16), orders=2)
    return build_atmosphere_tables(earth().with_aerosol(request.param), plan)


@pytest.mark.parametrize("altitude", [0.0, 1.0, 9000.0, TOP - BOTTOM, 1e6])
def test_extremes_are_finite_and_not_negative(sweep_tables: AtmosphereTables, altitude: float) -> None:
    """From the ground to space, in all directions, for suns from the zenith to 110 degrees."""
    camera = tensor(0.0, 0.0, BOTTOM + altitude)
    view = directions(torch.linspace(-0.5 * math.pi, 0.5 * math.pi, 181, dtype=torch.float64))[:, None]
    zenith = torch.tensor([0.0, 45.0, 80.0, 89.0, 90.0, 91.0, 100.0, 110.0], dtype=torch.float64).deg2rad()
    sun = directions(0.5 * math.pi - zenith, 0.3)
    seen = look_up_sky_radiance(sweep_tables, camera, view, sun)
    largest = float(seen.radiance.max())
    assert bool(torch.isfinite(seen.radiance).all())
    assert float(seen.radiance.min()) >= -1e-12 * largest
    assert bool(((seen.transmittance >= 0.0) & (seen.transmittance <= 1.0)).all())
    lit = look_up_surface_irradiance(
        sweep_tables, tensor(0.0, 0.0, BOTTOM + min(altitude, TOP - BOTTOM)), directions(tensor(1.2)), sun
    )
    for light in (lit.sun, lit.sky):
        assert bool((torch.isfinite(light) & (light >= 0.0)).all())
    point = camera + 5e3 * view
    haze = look_up_radiance_to_point(sweep_tables, camera, point, sun)
    assert bool(torch.isfinite(haze.radiance).all() & torch.isfinite(haze.transmittance).all())
    assert float(haze.radiance.min()) >= 0.0


def largest_jump(radiance: Tensor) -> float:
    """Largest step between neighbours of a sweep, of the largest value."""
    return float(radiance.diff(dim=0).abs().max() / radiance.abs().max())


def test_the_sky_is_continuous_up_to_the_horizon_and_through_sunset(sweep_tables: AtmosphereTables) -> None:
    """A quarter of the step makes at most 0.6 of the largest jump: towards the horizon light changes as the root of the angle."""
    camera = tensor(0.0, 0.0, BOTTOM + 1000.0)
    dip = -math.acos(BOTTOM / (BOTTOM + 1000.0))

    def sweep_view(low: float, high: float, count: int) -> Tensor:
        view = directions(torch.linspace(low, high, count, dtype=torch.float64))
        return look_up_sky_radiance(sweep_tables, camera, view, directions(tensor(0.2), 0.4)).radiance

    def sweep_sun(count: int) -> Tensor:
        suns = directions(torch.linspace(0.3, -0.35, count, dtype=torch.float64), 0.4)
        return look_up_sky_radiance(sweep_tables, camera, directions(tensor(0.1)), suns).radiance

    for low, high in ((dip + 1e-9, 0.3), (dip - 0.3, dip - 1e-9)):
        assert largest_jump(sweep_view(low, high, 6401)) < 0.6 * largest_jump(sweep_view(low, high, 1601))
    assert largest_jump(sweep_sun(6401)) < 0.6 * largest_jump(sweep_sun(1601))
    # From one side of the horizon to the other the ray loses all that lies behind it, which no step makes small.
    assert largest_jump(sweep_view(dip - 1e-9, dip + 1e-9, 2)) > 0.01


def test_what_cannot_be_looked_up_is_refused() -> None:
    up, ground = tensor(0.0, 0.0, 1.0), tensor(0.0, 0.0, BOTTOM)
    tables = small_tables()
    for camera, view, sun, shadow in (
        (ground[:2], up, up, 0.0),
        (ground * math.nan, up, up, 0.0),
        (ground, 2.0 * up, up, 0.0),
        (ground, up, up * math.inf, 0.0),
        (ground, up, up, -1.0),
        (ground, up, up, math.nan),
    ):
        with pytest.raises(ParameterError):
            look_up_sky_radiance(tables, camera, view, sun, shadow)
    with pytest.raises(ParameterError, match="apart from the camera"):
        look_up_radiance_to_point(tables, ground, ground, up)


def test_a_point_in_space_before_the_air_is_seen_as_it_is() -> None:
    camera, point = tensor(0.0, 0.0, TOP + 2e5), tensor(0.0, 0.0, TOP + 1e5)
    seen = look_up_radiance_to_point(small_tables(), camera, point, tensor(0.0, 0.0, 1.0))
    assert float(seen.radiance.abs().max()) == 0.0
    assert seen.transmittance.tolist() == [1.0, 1.0, 1.0]
    below = look_up_radiance_to_point(small_tables(), camera, tensor(0.0, 0.0, BOTTOM), tensor(0.0, 0.0, 1.0))
    assert float(below.radiance.min()) > 0.0


def test_a_sweep_of_many_rays_is_that_of_each() -> None:
    generator = torch.Generator().manual_seed(5)
    view = torch.nn.functional.normalize(torch.randn(50, 3, generator=generator, dtype=torch.float64), dim=-1)
    camera, sun = tensor(0.0, 0.0, BOTTOM + 500.0), directions(tensor(0.5))
    together = look_up_sky_radiance(small_tables(), camera, view, sun).radiance
    alone = torch.stack([look_up_sky_radiance(small_tables(), camera, one, sun).radiance for one in view])
    torch.testing.assert_close(together, alone, atol=1e-15, rtol=1e-12)
