import math

import pytest
import torch

from cloudfit.fog_picture import (
    aim_camera,
    build_plain,
    depth_to_sun,
    mean_sky,
    photograph_backdrop,
    put_fog,
    view_rays,
)
from render.errors import ParameterError
from render.media import ExponentialDecay, FogLight, LinearDecay, Uniform
from render.media.sphere import EARTH_RADIUS

SUN = torch.tensor([0.6, 0.0, 0.8], dtype=torch.float64)
WHITE = torch.ones(3, dtype=torch.float64)


def rays(elevation: float = 0.05) -> torch.Tensor:
    return view_rays(aim_camera(0.0, elevation, 0.7, (24, 16)))


def plain(medium: object) -> object:
    return build_plain(rays(), 12.0, 0.0, SUN, WHITE, medium, None)  # type: ignore[arg-type]


def test_the_camera_looks_where_it_is_aimed() -> None:
    directions = view_rays(aim_camera(math.radians(90.0), 0.2, 0.5, (3, 3)))
    torch.testing.assert_close(
        directions[1, 1], torch.tensor([math.cos(0.2), 0.0, math.sin(0.2)], dtype=torch.float64), atol=1e-6, rtol=0.0
    )
    assert directions[0, 1, 2] > directions[2, 1, 2]


def test_fog_takes_the_sun_from_the_ground() -> None:
    clear, foggy = plain(Uniform(0.0, 100.0)), plain(Uniform(0.02, 100.0))
    ground = torch.isfinite(clear.distance)  # type: ignore[attr-defined]
    assert torch.equal(clear.distance, foggy.distance)  # type: ignore[attr-defined]
    assert (foggy.radiance[ground] < clear.radiance[ground]).any()  # type: ignore[attr-defined]
    assert torch.equal(foggy.radiance[~ground], clear.radiance[~ground])  # type: ignore[attr-defined]


def test_a_given_sky_stands_behind_the_plain() -> None:
    sky = torch.full((16, 24, 3), 0.25)
    scene = build_plain(rays(), 12.0, 0.0, SUN, WHITE, Uniform(0.0, 100.0), sky)
    assert (scene.radiance[torch.isinf(scene.distance)] == 0.25).all()
    assert (scene.ambient > 0.25).all()


def test_the_sun_passes_through_what_is_above_a_point() -> None:
    medium = LinearDecay(0.02, 100.0)
    depth = depth_to_sun(medium, torch.tensor([0.0, 50.0, 100.0, 500.0], dtype=torch.float64), SUN)
    torch.testing.assert_close(depth, torch.tensor([1.25, 0.3125, 0.0, 0.0], dtype=torch.float64), rtol=1e-4, atol=0.0)
    raised = Uniform(0.02, 300.0, 200.0)
    assert depth_to_sun(raised, torch.tensor(0.0, dtype=torch.float64), SUN).item() == pytest.approx(2.5, rel=1e-4)


def test_the_mean_of_the_sky_is_between_its_extremes() -> None:
    mean = mean_sky(SUN, WHITE)
    assert ((mean > 0.1) & (mean < 1.0)).all()
    assert mean[2] > mean[0]


def test_dense_fog_takes_the_colour_of_a_photograph_s_sky() -> None:
    radiance = torch.rand(16, 24, 3, generator=torch.Generator().manual_seed(3))
    distance = torch.full((16, 24), 40.0)
    distance[:4] = math.inf
    backdrop = photograph_backdrop(radiance, distance, "depth.exr")
    torch.testing.assert_close(backdrop.ambient, radiance[:4].double().mean((0, 1)))
    light = FogLight(SUN, torch.zeros(3), backdrop.ambient)
    picture = put_fog(backdrop, Uniform(1.0, 1000.0), 100.0, rays(), light)
    torch.testing.assert_close(picture.radiance[-1, 0], backdrop.ambient, rtol=1e-6, atol=0.0)
    thin = put_fog(backdrop, Uniform(0.001, 1000.0), 100.0, rays(), light)
    torch.testing.assert_close(thin.transmittance[-1], torch.full((24,), math.exp(-0.04), dtype=torch.float64))
    indoors = photograph_backdrop(radiance, torch.arange(384.0).reshape(16, 24) + 1.0, "depth.exr")
    torch.testing.assert_close(indoors.ambient, radiance.reshape(-1, 3)[-38:].double().mean(0))
    with pytest.raises(ParameterError, match=r"depth.exr: expected a depth map of the size"):
        photograph_backdrop(radiance, distance[:3], "depth.exr")


def test_round_and_flat_ground_meet_where_one_follows_the_other() -> None:
    """On both sides of the elevation from which the ground counts as flat the pictures agree to 1e-3."""
    medium = ExponentialDecay(0.001, 500.0)
    pictures = []
    for degrees in (19.999, 20.001):
        sun = torch.tensor([0.0, math.cos(math.radians(degrees)), math.sin(math.radians(degrees))], dtype=torch.float64)
        backdrop = build_plain(rays(), 12.0, 0.0, sun, WHITE, medium, None)
        pictures.append(put_fog(backdrop, medium, 12.0, rays(), FogLight(sun, WHITE, WHITE, 0.5)).radiance)
    torch.testing.assert_close(*pictures, rtol=1e-3, atol=0.0)
    assert not torch.equal(*pictures)
    assert EARTH_RADIUS == 6_371_000.0


def test_blocks_are_averaged() -> None:
    backdrop = plain(Uniform(0.001, 100.0))
    picture = put_fog(backdrop, Uniform(0.001, 100.0), 12.0, rays(), FogLight(SUN, WHITE, WHITE))  # type: ignore[arg-type]
    small = picture.reduced(2)
    assert small.radiance.shape == (8, 12, 3)
    torch.testing.assert_close(small.radiance.mean((0, 1)), picture.radiance.mean((0, 1)))
    assert set(small.layers()) == {"rgb", "scattered", "transmittance", "distance"}
