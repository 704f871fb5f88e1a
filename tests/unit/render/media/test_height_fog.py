import math

import pytest
import torch

from render.errors import ParameterError
from render.media import (
    ExponentialDecay,
    FogLight,
    LinearDecay,
    Uniform,
    compose_fog,
    compute_in_scattering,
    extinction_from_visibility,
    ground_distance,
)
from render.media.sphere import EARTH_RADIUS

DIRECTION = torch.nn.functional.normalize(
    torch.tensor([[1.0, 2.0, -0.1], [0.3, -1.0, 0.5]], dtype=torch.float64), dim=-1
)
BACKGROUND = torch.tensor([[0.2, 0.4, 0.6], [0.5, 0.7, 1.0]], dtype=torch.float64)
DISTANCE = torch.tensor([300.0, math.inf], dtype=torch.float64)


def light(**changes: object) -> FogLight:
    settings: dict = {
        "sun_direction": torch.tensor([1.0, 0.0, 1.0]),
        "irradiance": torch.tensor([3.0, 2.0, 1.0]),
        "ambient": torch.tensor([0.1, 0.2, 0.3]),
        "asymmetry": 0.6,
        "albedo": 0.9,
    }
    return FogLight(**{**settings, **changes})


def test_radiance_is_what_is_left_plus_what_is_scattered() -> None:
    medium = LinearDecay(0.01, 100.0)
    image = compose_fog(BACKGROUND, medium, 5.0, DIRECTION, DISTANCE, light())
    torch.testing.assert_close(image.radiance, image.transmittance * BACKGROUND + image.in_scattering)
    v, sun_slope = DIRECTION[0, 2].item(), math.sqrt(0.5)
    gathered = compute_in_scattering(medium, torch.tensor(5.0, dtype=torch.float64), v, sun_slope, 300.0).item()
    cosine = (DIRECTION[0, 0] + DIRECTION[0, 2]).item() * sun_slope
    phase = (1.0 - 0.36) / (4.0 * math.pi * (1.36 - 1.2 * cosine) ** 1.5)
    expected = 0.9 * (3.0 * phase * gathered + 0.1 * (1.0 - image.transmittance[0, 0].item()))
    assert image.in_scattering[0, 0].item() == pytest.approx(expected, rel=1e-6)
    other = compose_fog(BACKGROUND, medium, 5.0, DIRECTION, DISTANCE, light(asymmetry=-0.6))
    assert other.in_scattering[0, 0].item() != pytest.approx(expected, rel=1e-2)


def test_without_fog_nothing_changes_and_dense_fog_hides_everything() -> None:
    clear = compose_fog(BACKGROUND, Uniform(0.0, 100.0), 5.0, DIRECTION, DISTANCE, light())
    assert torch.equal(clear.radiance, BACKGROUND)
    dense = compose_fog(BACKGROUND, Uniform(100.0, 100.0), 5.0, DIRECTION, DISTANCE, light())
    assert (dense.transmittance == 0.0).all()
    torch.testing.assert_close(dense.radiance, (0.9 * light().ambient.double()).expand(2, 3))


def test_light_from_everywhere_stays_as_it_is_in_fog_that_absorbs_nothing() -> None:
    """The furnace: background and ambient light alike, no sun, albedo 1."""
    grey = torch.full_like(BACKGROUND, 0.7)
    furnace = light(irradiance=torch.zeros(3), ambient=torch.full((3,), 0.7), albedo=1.0)
    image = compose_fog(grey, ExponentialDecay(0.01, 40.0), 5.0, DIRECTION, DISTANCE, furnace)
    torch.testing.assert_close(image.radiance, grey, rtol=1e-6, atol=0.0)
    lossy = light(irradiance=torch.zeros(3), ambient=torch.full((3,), 0.7), albedo=0.9)
    assert compose_fog(grey, ExponentialDecay(0.01, 40.0), 5.0, DIRECTION, DISTANCE, lossy).radiance[0, 0] < 0.69


def test_fog_may_be_coloured() -> None:
    medium = ExponentialDecay(torch.tensor([0.001, 0.002, 0.004], dtype=torch.float64), 40.0)
    image = compose_fog(BACKGROUND, medium, 5.0, DIRECTION, DISTANCE, light())
    t = image.transmittance[0]
    assert t.shape == (3,)
    torch.testing.assert_close(t[0] ** 2, t[1])
    torch.testing.assert_close(t[1] ** 2, t[2])


def test_a_set_sun_lights_high_fog_over_round_ground_alone() -> None:
    """The sun 1 degree below the horizon, seen from 5 km, where the dip is 2.3 degrees."""
    sun = torch.tensor([0.0, math.cos(math.radians(1.0)), -math.sin(math.radians(1.0))])
    medium = ExponentialDecay(1e-4, 1200.0, base=0.0)
    dark = light(sun_direction=sun, ambient=torch.zeros(3))
    arguments = (torch.zeros_like(BACKGROUND), medium, 5000.0, DIRECTION, DISTANCE, dark)
    lit = compose_fog(*arguments, EARTH_RADIUS).radiance[1]
    assert (lit > 1e-5).all()
    assert (compose_fog(*arguments).radiance[1] < 0.1 * lit).all()


def test_gradients_reach_everything() -> None:
    background, extinction, height = (
        BACKGROUND.clone(),
        torch.tensor(0.01, dtype=torch.float64),
        torch.tensor(5.0, dtype=torch.float64),
    )
    values = [v.requires_grad_() for v in (background, extinction, height)]

    def radiance(b: torch.Tensor, e: torch.Tensor, h: torch.Tensor) -> torch.Tensor:
        return compose_fog(b, ExponentialDecay(e, 40.0), h, DIRECTION, DISTANCE, light()).radiance

    assert torch.autograd.gradcheck(radiance, values)


def test_the_ground_is_where_the_ray_meets_it() -> None:
    distance = ground_distance(10.0, torch.tensor([-0.5, -1.0, 0.0, 0.5, -1e-9], dtype=torch.float64), 5.0)
    assert distance.tolist() == [10.0, 5.0, math.inf, math.inf, 5.0 / 1e-9]
    assert ground_distance(5.0, torch.tensor(-0.5), 5.0) == 0.0
    assert ground_distance(4.0, torch.tensor(-0.5), 5.0) == math.inf


def test_visibility_is_where_a_twentieth_is_left() -> None:
    assert math.exp(-extinction_from_visibility(800.0) * 800.0) == pytest.approx(0.05)
    assert math.exp(-extinction_from_visibility(400.0) * 800.0) != pytest.approx(0.05)
    for visibility in (0.0, -1.0, math.nan):
        with pytest.raises(ParameterError, match="visibility"):
            extinction_from_visibility(visibility)


def test_light_and_pictures_that_are_none_are_refused() -> None:
    for changes, words in (
        ({"asymmetry": 1.0}, "asymmetry"),
        ({"albedo": 1.1}, "albedo"),
        ({"irradiance": torch.tensor([1.0, math.nan, 1.0])}, "irradiance"),
        ({"ambient": torch.tensor([-1.0, 0.0, 0.0])}, "ambient"),
    ):
        with pytest.raises(ParameterError, match=words):
            light(**changes)
    with pytest.raises(ParameterError, match="of one picture"):
        compose_fog(BACKGROUND, Uniform(0.1, 1.0), 0.0, DIRECTION, DISTANCE[:1], light())
