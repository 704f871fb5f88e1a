"""Axes and look-up of the table of a camera, on tables whose light is known."""

import math

import pytest
import torch

from render.atmosphere.accurate_sky import scattering_phases
from render.atmosphere.sky_view import (
    SkyView,
    angle_spans,
    azimuth_axis,
    check_altitude,
    horizon_angle,
    horizon_axis,
    look_up_sky_view,
)
from render.errors import ParameterError
from tests.support.skies import coarse_source

SOURCE = coarse_source()
PLANET = SOURCE.atmosphere
SUN = torch.tensor([0.0, 0.6, 0.8], dtype=torch.float64)
UP = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)


def made_up(altitude: float = 0.0, molecules: float = 0.0, more: float = 0.0) -> SkyView:
    """A view of even light above the horizon, and twice as much below it."""
    light = torch.cat([torch.full((8, 5, 3), value) for value in (molecules, 0.0, more)], -1).double()
    light[4:] *= 2.0
    return SkyView(SOURCE, altitude, SUN, light, torch.full((8, 3), 0.5, dtype=torch.float64))


def test_the_horizon_sinks_as_a_camera_rises() -> None:
    assert horizon_angle(PLANET, 0.0) == pytest.approx(0.5 * math.pi, abs=1e-12)
    for altitude in (2.0, 9000.0, 4e5):
        exact = math.pi - math.asin(PLANET.bottom_radius / (PLANET.bottom_radius + altitude))
        assert horizon_angle(PLANET, altitude) == pytest.approx(exact, abs=1e-8)
        assert horizon_angle(PLANET, altitude) > 0.5 * math.pi
    up, down = angle_spans(PLANET, 9000.0)
    assert up + down == pytest.approx(math.pi)
    limb, below = angle_spans(PLANET, 4e5)
    assert 0.0 < limb < 0.05
    assert below == pytest.approx(down, abs=0.4)


def test_nodes_crowd_at_the_horizon_and_the_sun() -> None:
    for axis, whole in ((horizon_axis(32), 1.0), (azimuth_axis(32), math.pi)):
        assert float(axis[0]) == 0.0
        assert float(axis[-1]) == pytest.approx(whole)
        steps = axis.diff()
        assert bool((steps.diff() > 0.0).all())


def test_light_jumps_at_the_horizon_alone() -> None:
    view = made_up(more=3.0)
    angle = torch.tensor([0.0, 0.5, 1.57, 1.5708, 1.7, math.pi], dtype=torch.float64)
    direction = torch.stack([torch.sin(angle), torch.zeros_like(angle), torch.cos(angle)], -1)
    seen, ground = look_up_sky_view(view, direction)
    assert ground.tolist() == [False, False, False, True, True, True]
    torch.testing.assert_close(seen.radiance[:, 0], torch.where(ground, 6.0, 3.0).double())
    assert bool((seen.transmittance == 0.5).all())


def test_phase_functions_come_in_at_the_look_up() -> None:
    directions = torch.stack([SUN, UP[0], -SUN * torch.tensor([1.0, 1.0, -1.0])])
    seen, _ = look_up_sky_view(made_up(molecules=7.0), directions)
    phase = scattering_phases(PLANET.mie_asymmetry, directions @ SUN)[:, 0]
    torch.testing.assert_close(seen.radiance[:, 1], 7.0 * phase)
    assert float(seen.radiance[0, 1]) > 1.3 * float(seen.radiance[2, 1])


def test_both_sides_of_the_sun_are_the_same() -> None:
    view = made_up(more=1.0)
    light = view.light * torch.linspace(1.0, 2.0, 5).double()[None, :, None]
    view = SkyView(SOURCE, 0.0, SUN, light, view.transmittance)
    east, west, ahead = look_up_sky_view(
        view, torch.tensor([[0.8, 0.0, 0.6], [-0.8, 0.0, 0.6], [0.0, 0.8, 0.6]], dtype=torch.float64)
    )[0].radiance
    torch.testing.assert_close(east, west)
    assert float(ahead[0]) == pytest.approx(1.0)
    assert float(east[0]) > 1.2


def test_beyond_the_limb_there_is_nothing() -> None:
    seen, ground = look_up_sky_view(made_up(4e5, more=3.0), torch.cat([UP, -UP]))
    assert ground.tolist() == [False, True]
    assert seen.radiance[:, 0].tolist() == [0.0, 6.0]
    assert seen.transmittance[:, 0].tolist() == [1.0, 0.5]


def test_impossible_tables_are_refused() -> None:
    for altitude in (-1.0, math.nan, math.inf):
        with pytest.raises(ParameterError, match="on the ground or above"):
            check_altitude(altitude)
    view = made_up()
    for light, transmittance in (
        (view.light[:7], view.transmittance[:7]),
        (view.light[..., :6], view.transmittance),
        (view.light, view.transmittance[:4]),
    ):
        with pytest.raises(ParameterError, match="transmittances"):
            SkyView(SOURCE, 0.0, SUN, light, transmittance)
