"""A cloud in an atmosphere: the sky behind, the light on it, the air before it."""

import math
from dataclasses import replace

import pytest
import torch

from cloudfit.atmosphere_picture import CloudPlace, compose_air, render_in_atmosphere
from cloudfit.scene import Scene
from cloudfit.sky_models import AccurateSky
from precompute.atmosphere import sky_view
from precompute.error_budget import Effort
from render.atmosphere.spectral_colour import convert_to_linear_srgb
from render.colour import luminance
from render.errors import ParameterError
from tests.support.skies import coarse_source
from tests.support.small_scene import small_scene

MODEL = AccurateSky(coarse_source())
PARAMETERS = {"sunlight_intensity": 8.0, "asymmetry": 0.5, "extinction": 0.1, "albedo": 0.95, "ambient": 0.3}
EFFORT = Effort(2, 200, 2_000, 4)
BOTTOM = MODEL.atmosphere.bottom_radius


@pytest.fixture(autouse=True)
def coarse_views(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sky_view, "LOW", (32, 24))


def scene(elevation: float = 40.0) -> Scene:
    return replace(small_scene(), sun_elevation=math.radians(elevation))


def test_a_cloud_stands_along_the_axis_of_view() -> None:
    camera = scene().camera
    assert CloudPlace(0.0).distance_for(camera) == pytest.approx(math.dist(camera.position, camera.target))
    point = CloudPlace(100.0, 3000.0).point(camera, BOTTOM)
    eye = torch.tensor([0.0, 0.0, BOTTOM + 100.0], dtype=torch.float64)
    assert float((point - eye).norm()) == pytest.approx(3000.0)
    axis = torch.tensor(camera.target, dtype=torch.float64) - torch.tensor(camera.position, dtype=torch.float64)
    torch.testing.assert_close((point - eye) / 3000.0, axis / axis.norm(), rtol=0.0, atol=1e-9)


def test_the_air_takes_light_from_the_cloud_and_adds_its_own() -> None:
    near, sky = compose_air(scene(), MODEL, CloudPlace(100.0, 500.0))
    far, same = compose_air(scene(), MODEL, CloudPlace(100.0, 20_000.0))
    assert torch.equal(sky, same)
    assert bool((far.light > near.light).all() & (far.light < sky).all())
    assert bool((far.ambient.mean((0, 1)) < near.ambient.mean((0, 1))).all())
    red, blue = (far.sunlight / near.sunlight).mean((0, 1))[[0, 2]]
    assert bool(blue < red), "blue is taken first"
    solar = torch.tensor(MODEL.atmosphere.solar_irradiance, dtype=torch.float64)
    above_the_air = convert_to_linear_srgb(solar, MODEL.atmosphere.wavelengths)
    assert bool((near.sunlight < above_the_air).all() & (near.sunlight > 0.4 * above_the_air).all())


def test_a_low_sun_is_red() -> None:
    high, low = (compose_air(scene(e), MODEL, CloudPlace(100.0, 1000.0))[0].sunlight.mean((0, 1)) for e in (60.0, 2.0))
    assert float(low[2] / low[0]) < 0.3 * float(high[2] / high[0])
    dark = compose_air(scene(-10.0), MODEL, CloudPlace(100.0, 1000.0))[0].sunlight
    assert float(dark.max()) == 0.0


def test_the_sun_of_the_cloud_is_that_of_its_own_zenith() -> None:
    """A cloud far ahead, has another zenith than the viewer: there the sun stands higher if it is ahead, and lower if it is behind."""
    camera = scene().camera
    axis = torch.tensor(camera.target, dtype=torch.float64) - torch.tensor(camera.position, dtype=torch.float64)
    azimuth = math.atan2(float(axis[0]), float(axis[1]))
    towards, away = (replace(scene(1.0), sun_azimuth=azimuth + turn) for turn in (0.0, math.pi))
    lit, shaded = (compose_air(one, MODEL, CloudPlace(0.0, 60_000.0))[0].sunlight.mean() for one in (towards, away))
    assert float(lit) > 1.1 * float(shaded)


def test_the_picture_is_a_cloud_before_the_sky() -> None:
    place = CloudPlace(100.0, 2000.0)
    air, sky = compose_air(scene(), MODEL, place)
    picture = render_in_atmosphere(scene(), PARAMETERS, MODEL, place, EFFORT)
    clear = picture.transmittance == 1.0
    torch.testing.assert_close(picture.rgb[clear], sky[clear])
    torch.testing.assert_close(picture.rgb, picture.single + picture.multiple + picture.ambient + picture.sky)
    hidden = (1.0 - picture.transmittance)[..., None]
    torch.testing.assert_close(picture.sky, hidden * air.light + (1.0 - hidden) * sky)
    thick = picture.transmittance < 0.01
    assert not torch.allclose(picture.sky[thick], sky[thick], rtol=0.05)
    grey = (picture.single / air.sunlight)[thick]
    torch.testing.assert_close(grey[:, 0], grey[:, 2])
    assert 100.0 < float(luminance(picture.rgb[thick]).mean()) < 50_000.0


def test_the_ground_hides_what_lies_behind_it() -> None:
    """From 50 m rays that sink by one in twenty meet the ground after a kilometre."""
    down = scene().camera.rays()[1][:, 2].reshape(36, 48) < -0.05
    assert bool(down.any())
    near, _ = compose_air(scene(), MODEL, CloudPlace(50.0, 900.0))
    far, sky = compose_air(scene(), MODEL, CloudPlace(50.0, 1100.0))
    assert bool((torch.as_tensor(far.visible)[down] == 0.0).all())
    assert float(torch.as_tensor(near.visible)[down].mean()) > float(torch.as_tensor(far.visible)[down].mean())
    assert bool((torch.as_tensor(far.visible)[~down] == 1.0).any())
    picture = render_in_atmosphere(scene(), PARAMETERS, MODEL, CloudPlace(50.0, 1100.0), EFFORT)
    torch.testing.assert_close(picture.rgb[down], sky[down])


def test_impossible_places_are_refused() -> None:
    for altitude, distance in ((-1.0, None), (math.nan, None), (0.0, 0.0), (0.0, math.inf)):
        with pytest.raises(ParameterError):
            CloudPlace(altitude, distance)
    camera = scene().camera
    down = replace(camera, position=camera.target, target=camera.position)  # type: ignore[type-var]
    with pytest.raises(ParameterError, match="below the ground"):
        CloudPlace(2.0, 5000.0).point(down, BOTTOM)
