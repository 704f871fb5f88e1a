import dataclasses
import math

import pytest
import torch

from render.errors import ParameterError
from render.random_streams import child_generator
from render.shafts.participating_media import SpheroidMedium, build_medium_grid

FOG = SpheroidMedium(middle=(10.0, -5.0, 20.0), spread=(8.0, 6.0, 3.0), count=12, radius=9.0, seed=4)
ONE = SpheroidMedium(
    (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1, 10.0, radius_variation=0.0, flattening=0.5, noise_amplitude=0.0
)
POINTS = torch.tensor(FOG.middle) + 25.0 * torch.randn(4000, 3, generator=child_generator(1))


def along(axis: int, *distances: float) -> torch.Tensor:
    points = torch.zeros(len(distances), 3)
    points[:, axis] = torch.tensor(distances)
    return points


def test_a_spheroid_without_noise_has_its_closed_form() -> None:
    """p(d) = d^2 (3 - 2 d) with d = 1 - distance / radius: 1, 0.84375, 0.5, 0.15625, 0 from the centre out."""
    expected = pytest.approx([1.0, 0.84375, 0.5, 0.15625, 0.0, 0.0], abs=1e-6)
    assert ONE.evaluate_density(along(0, 0.0, 2.5, 5.0, 7.5, 10.0, 11.0)).tolist() == expected
    assert ONE.evaluate_density(along(2, 0.0, 1.25, 2.5, 3.75, 5.0, 5.5)).tolist() == expected
    assert ONE.evaluate_density(along(2, 0.0, 2.5, 5.0, 7.5, 10.0, 11.0)).tolist() != expected


def test_two_spheroids_in_one_place_hide_like_two_screens() -> None:
    two = dataclasses.replace(ONE, count=2)
    assert two.evaluate_density(along(0, 5.0)).item() == pytest.approx(0.75)


def test_density_falls_with_height_and_outwards() -> None:
    high = dataclasses.replace(ONE, base=-1.0, scale_height=2.0)
    assert high.evaluate_density(along(2, 1.25)).item() == pytest.approx(0.84375 * math.exp(-2.25 / 2.0), rel=1e-5)
    assert high.evaluate_density(along(2, -1.25)).item() == 0.0
    wide = dataclasses.replace(ONE, extent=4.0)
    assert wide.evaluate_density(along(1, 5.0)).item() == pytest.approx(0.5 * math.exp(-25.0 / 32.0), rel=1e-5)
    assert wide.evaluate_density(along(2, 2.5)).item() == pytest.approx(0.5)


def test_the_seed_decides_everything() -> None:
    density = FOG.evaluate_density(POINTS)
    assert torch.equal(dataclasses.replace(FOG).evaluate_density(POINTS), density)
    other = dataclasses.replace(FOG, seed=5).evaluate_density(POINTS)
    assert float((other - density).abs().max()) > 0.3
    assert 0.02 < float((density > 0.0).float().mean()) < 0.9


def test_centres_are_normal_and_radii_uniform() -> None:
    many = dataclasses.replace(FOG, count=20_000)
    deviation = many.offsets / torch.tensor(FOG.spread)
    assert deviation.mean(0).tolist() == pytest.approx([0.0] * 3, abs=4.0 / 20_000**0.5)
    assert deviation.std(0).tolist() == pytest.approx([1.0] * 3, abs=4.0 / (2 * 20_000) ** 0.5)
    assert float(many.radii.min()) == pytest.approx(0.7 * 9.0, rel=1e-3)
    assert float(many.radii.mean()) == pytest.approx(9.0, rel=4 * 0.3 / 3**0.5 / 20_000**0.5)


def test_noise_bends_the_surface_within_its_amplitude() -> None:
    rough = dataclasses.replace(ONE, noise_amplitude=0.4, noise_wavelength=5.0, flattening=1.0)
    direction = torch.nn.functional.normalize(torch.randn(500, 3, generator=child_generator(2)), dim=1)
    assert bool((rough.evaluate_density(14.01 * direction) == 0.0).all())
    assert bool((rough.evaluate_density(5.9 * direction) > 0.0).all())
    inside = (rough.evaluate_density(10.0 * direction) > 0.0).float().mean()
    assert 0.1 < float(inside) < 0.9
    assert not bool((ONE.evaluate_density(10.01 * direction) > 0.0).any())


def test_wind_carries_the_medium_without_changing_it() -> None:
    windy = dataclasses.replace(FOG, wind=(3.0, -1.0, 0.0))
    moved = windy.evaluate_density(POINTS + 20.0 * torch.tensor([3.0, -1.0, 0.0]), time=20.0)
    assert torch.allclose(moved, FOG.evaluate_density(POINTS), atol=2e-4)
    assert not torch.allclose(windy.evaluate_density(POINTS, time=20.0), FOG.evaluate_density(POINTS), atol=0.1)


def test_shapes_change_smoothly_with_time() -> None:
    changing = dataclasses.replace(FOG, change_time=60.0)
    now, soon, later = (changing.evaluate_density(POINTS, time) for time in (0.0, 0.1, 30.0))
    assert torch.equal(now, FOG.evaluate_density(POINTS, time=30.0))
    assert 0.0 < float((soon - now).abs().max()) < 0.02
    assert float((later - now).abs().max()) > 0.1


def test_the_user_controls_the_strength() -> None:
    density = FOG.evaluate_density(POINTS)
    assert torch.allclose(FOG.evaluate_density(POINTS, strength=0.25), 0.25 * density)
    assert float(FOG.evaluate_density(POINTS, strength=0.0).abs().max()) == 0.0
    assert 0.0 <= float(density.min()) <= float(density.max()) <= 1.0


def test_the_box_holds_all_of_the_medium() -> None:
    for time in (0.0, 50.0):
        medium = dataclasses.replace(FOG, wind=(1.0, 0.0, 0.0), base=15.0)
        lower, upper = medium.bounds(time)
        points = POINTS + torch.tensor([time, 0.0, 0.0])
        inside = ((points >= lower) & (points <= upper)).all(1)
        assert float(medium.evaluate_density(points, time)[~inside].abs().max()) == 0.0
        assert float(medium.evaluate_density(points, time)[inside].abs().max()) > 0.1


def test_the_grid_converges_to_the_medium() -> None:
    density = FOG.evaluate_density(POINTS)
    errors = [
        float((build_medium_grid(FOG, n).look_up_density(POINTS) - density).square().mean().sqrt())
        for n in (16, 32, 64)
    ]
    assert errors[0] > 2.0 * errors[1] > 4.0 * errors[2]
    assert errors[2] < 0.01
    assert build_medium_grid(FOG, 32).density.shape == build_medium_grid(FOG, 32, strength=0.5).density.shape
    assert max(build_medium_grid(FOG, 32).density.shape) == 32


def test_media_that_cannot_be_are_refused() -> None:
    for change in ({"radius": 0.0}, {"extent": -1.0}, {"noise_amplitude": 1.0}, {"count": -1}, {"scale_height": 5.0}):
        with pytest.raises(ParameterError):
            dataclasses.replace(FOG, **change)
    with pytest.raises(ParameterError, match="finite places"):
        dataclasses.replace(FOG, middle=(math.nan, 0.0, 0.0))
    with pytest.raises(ParameterError, match="fills no box"):
        build_medium_grid(dataclasses.replace(FOG, count=0), 8)
    with pytest.raises(ParameterError, match="fills no box"):
        dataclasses.replace(FOG, base=1e4).bounds()
    with pytest.raises(ParameterError, match="strength"):
        FOG.evaluate_density(POINTS, strength=-1.0)
    with pytest.raises(ParameterError, match="1024"):
        build_medium_grid(FOG, 0)
    assert float(dataclasses.replace(FOG, count=0).evaluate_density(POINTS).abs().max()) == 0.0


def test_points_in_double_precision_have_the_same_density() -> None:
    density = FOG.evaluate_density(POINTS.double())
    assert density.dtype == torch.float64
    assert torch.equal(density.float(), FOG.evaluate_density(POINTS))
    assert FOG.evaluate_density(POINTS[:0]).shape == (0,)
