"""Axes of the source table and its look-up."""

import math

import pytest
import torch

from render.atmosphere.earth import earth
from render.atmosphere.shells import cut_into_shells
from render.atmosphere.source_function import (
    SourceFunction,
    altitude_nodes,
    angle_nodes,
    azimuth_nodes,
    look_up_ground_sky_irradiance,
    look_up_source,
    place_of_altitude,
    place_of_angle,
    place_of_azimuth,
    place_of_sun,
    sun_angle_nodes,
)
from render.atmosphere.sun_columns import build_sun_columns
from render.errors import ParameterError

PLANET = earth()
COUNT = 17
NUMBERS = torch.arange(COUNT, dtype=torch.float64)


def test_places_are_the_inverse_of_nodes() -> None:
    altitude = altitude_nodes(PLANET, COUNT)
    assert (float(altitude[0]), float(altitude[-1])) == (0.0, PLANET.thickness)
    torch.testing.assert_close(place_of_altitude(PLANET, altitude, COUNT), NUMBERS)
    assert not torch.allclose(place_of_altitude(PLANET, 1.1 * altitude, COUNT), NUMBERS)
    sun = sun_angle_nodes(COUNT)
    assert (float(sun[0]), float(sun[-1])) == pytest.approx((0.0, math.pi))
    torch.testing.assert_close(place_of_sun(torch.cos(sun), COUNT), NUMBERS, atol=1e-6, rtol=0.0)
    torch.testing.assert_close(place_of_angle(torch.cos(angle_nodes(COUNT)), COUNT), NUMBERS, atol=1e-6, rtol=0.0)


def test_the_azimuth_is_the_angle_around_the_sun_from_the_zenith() -> None:
    theta, angle = 0.7, 0.4
    azimuth = azimuth_nodes(COUNT)
    cos_view = math.cos(angle) * math.cos(theta) + math.sin(angle) * math.sin(theta) * torch.cos(azimuth)
    cos_sun, between = (torch.tensor(math.cos(value), dtype=torch.float64) for value in (theta, angle))
    torch.testing.assert_close(place_of_azimuth(cos_view, cos_sun, between, COUNT), NUMBERS, atol=1e-6, rtol=0.0)
    one = torch.ones((), dtype=torch.float64)
    assert math.isfinite(float(place_of_azimuth(one, one, one, COUNT)))


def test_the_sun_is_finest_at_the_horizon() -> None:
    steps = sun_angle_nodes(COUNT).diff()
    assert int(steps.argmin()) in (COUNT // 2 - 1, COUNT // 2)
    assert float(steps.max() / steps.min()) > 5.0


def test_a_look_up_at_a_node_is_its_value() -> None:
    generator = torch.Generator().manual_seed(8)
    table = torch.rand(4, 5, 6, 7, 4, generator=generator, dtype=torch.float64)
    theta, angle, azimuth = sun_angle_nodes(5)[1], angle_nodes(6)[2], azimuth_nodes(7)[3]
    cos_view = torch.cos(angle) * torch.cos(theta) + torch.sin(angle) * torch.sin(theta) * torch.cos(azimuth)
    radius = PLANET.bottom_radius + altitude_nodes(PLANET, 4)[1]
    found = look_up_source(PLANET, table, radius, cos_view, torch.cos(theta), torch.cos(angle))
    torch.testing.assert_close(found, table[1, 1, 2, 3].reshape(2, 2))
    assert not torch.allclose(found, table[1, 2, 2, 3].reshape(2, 2))
    irradiance = table[0, :, 0, 0]
    torch.testing.assert_close(look_up_ground_sky_irradiance(irradiance, torch.cos(theta)), irradiance[1])


def test_tables_that_do_not_fit_are_refused() -> None:
    shells = cut_into_shells(PLANET)
    columns = build_sun_columns(shells, 4, 4)
    right, sky = torch.zeros(4, 5, 6, 7, 6), torch.zeros(5, 3)
    assert SourceFunction(shells, columns, right, sky, 4, 8).atmosphere is PLANET
    with pytest.raises(ParameterError, match="source"):
        SourceFunction(shells, columns, right[..., :5], sky, 4, 8)
    with pytest.raises(ParameterError, match="irradiance"):
        SourceFunction(shells, columns, right, sky[:4], 4, 8)
