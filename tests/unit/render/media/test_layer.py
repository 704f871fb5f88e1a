import math

import numpy as np
import pytest
import torch

from render.errors import ParameterError
from render.media import MEDIA, ExponentialDecay, LinearDecay, Uniform, compute_optical_depth, find_distance
from render.media.layer import cut_ray, finite_or, match
from tests.support.fog_cases import draw_cases


def numbers(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_a_ray_is_cut_at_the_borders() -> None:
    medium = Uniform(0.01, top=100.0, base=40.0)
    cases = [  # height, slope, distance; start, length
        (50.0, 0.5, 10.0, 0.0, 10.0),
        (50.0, 0.5, math.inf, 0.0, 100.0),
        (0.0, 0.5, math.inf, 80.0, 120.0),
        (0.0, 0.5, 100.0, 80.0, 20.0),
        (0.0, 0.5, 70.0, 0.0, 0.0),
        (200.0, -1.0, math.inf, 100.0, 60.0),
        (200.0, 0.5, math.inf, 0.0, 0.0),
        (200.0, 0.0, math.inf, 0.0, 0.0),
        (50.0, 0.0, math.inf, 0.0, math.inf),
        (50.0, 0.0, 7.0, 0.0, 7.0),
        (50.0, 1e-300, 7.0, 0.0, 7.0),
        (100.0, 1e-300, 7.0, 0.0, 0.0),
        (40.0, -1e-17, 7.0, 0.0, 0.0),
        (100.0, -1.0, 7.0, 0.0, 7.0),
        (1e7, -1.0, math.inf, 1e7 - 100.0, 60.0),
    ]
    height, slope, distance, start, length = (numbers(*column) for column in zip(*cases, strict=True))
    section = cut_ray(medium, height - medium.datum, slope, distance)
    torch.testing.assert_close(section.start, start, rtol=1e-12, atol=1e-9)
    torch.testing.assert_close(section.length, length, rtol=1e-12, atol=1e-9)


def test_fog_without_a_top_has_rays_without_an_end() -> None:
    medium = ExponentialDecay(0.01, 50.0, base=10.0)
    section = cut_ray(medium, numbers(0.0, 20.0, 20.0), numbers(0.5, 0.5, -0.5), math.inf)
    assert section.unbounded.tolist() == [True, True, False]
    assert section.start.tolist() == [20.0, 0.0, 0.0]
    assert section.length.tolist() == [math.inf, math.inf, 20.0]


@pytest.mark.parametrize("name", MEDIA)
def test_the_distance_to_a_depth_is_the_inverse_of_the_depth(name: str) -> None:
    cases = draw_cases(name, 3000, seed=7)
    total = compute_optical_depth(cases.medium, cases.height, cases.slope)
    share = torch.from_numpy(np.random.default_rng(3).uniform(0.0, 1.0, total.shape)).clamp(min=1e-6)
    depth = torch.where(torch.isinf(total), 20.0 * share, total * share)
    distance = find_distance(cases.medium, cases.height, cases.slope, depth)
    seen = depth > 0.0
    again = compute_optical_depth(cases.medium, cases.height, cases.slope, distance)
    # What is left of the depth when the distance is rounded, ahead of the fog and within it.
    rounding = (
        4e-16 * distance * (cases.medium.extinction_at(cases.height - cases.medium.datum) + depth.new_tensor(0.0))
    )
    error = (again - depth).abs() / depth
    near = seen & (rounding.abs() < 1e-11 * depth)
    assert near.float().mean() > 0.3
    assert error[near].max() < 1e-9
    wrong = compute_optical_depth(cases.medium, cases.height, -cases.slope, distance)
    assert ((wrong - depth).abs() / depth)[near].max() > 0.5
    assert (find_distance(cases.medium, cases.height, cases.slope, 2.0 * total + 1.0) == math.inf).all()


@pytest.mark.parametrize("name", MEDIA)
def test_the_depth_to_the_border_is_reached_at_the_border(name: str) -> None:
    medium = MEDIA[name](0.01, 100.0)
    assert find_distance(medium, 200.0, numbers(-0.5), 0.0).item() == pytest.approx(
        0.0 if name == "exponential" else 200.0
    )
    assert find_distance(medium, -10.0, numbers(0.5), 0.0).item() == pytest.approx(20.0)
    assert find_distance(medium, -10.0, numbers(-0.5), 0.0).item() == math.inf


def test_a_camera_far_above_finds_the_fog() -> None:
    """The extinction at the eye underflows; the depth does not."""
    medium = ExponentialDecay(0.01, 100.0)
    distance = find_distance(medium, 1e7, numbers(-1.0), 0.5)
    assert 1e7 - distance.item() == pytest.approx(100.0 * math.log(2.0), rel=1e-9)
    assert compute_optical_depth(medium, 1e7, numbers(-1.0)).item() == pytest.approx(1.0, rel=1e-12)


def test_gradients_pass_through_the_distance() -> None:
    for medium in (Uniform(0.01, 100.0), LinearDecay(0.01, 100.0), ExponentialDecay(0.01, 60.0)):
        for slope in (0.0, 0.3, -0.3):
            values = [v.requires_grad_() for v in numbers(150.0 if slope < 0 else 30.0, slope, 0.2).unbind()]
            values = [v.detach().requires_grad_() for v in values]
            assert torch.autograd.gradcheck(lambda h, v, d, m=medium: find_distance(m, h, v, d), values, rtol=1e-5)


def test_numbers_follow_tensors() -> None:
    first, second = match(0.3, numbers(1.0, 2.0))
    assert first.dtype == torch.float64
    assert first.tolist() == [0.3, 0.3]
    assert second.shape == (2,)
    assert match(0.3, torch.tensor(1.0))[0].dtype == torch.float32
    assert finite_or(math.inf, 3.0) == 3.0
    assert finite_or(numbers(math.inf, 1.0), 3.0).tolist() == [3.0, 1.0]  # type: ignore[union-attr]


def test_layers_that_are_none_are_refused() -> None:
    for make, words in (
        (lambda: Uniform(-0.1, 100.0), "extinction"),
        (lambda: Uniform(math.nan, 100.0), "extinction"),
        (lambda: Uniform(0.1, 100.0, 100.0), "base below the top"),
        (lambda: LinearDecay(0.1, math.inf), "finite borders"),
        (lambda: LinearDecay(0.1, -1.0), "base below the top"),
        (lambda: ExponentialDecay(0.1, 0.0), "scale height"),
        (lambda: ExponentialDecay(torch.tensor([0.1, math.inf]), 1.0), "extinction"),
    ):
        with pytest.raises(ParameterError, match=words):
            make()
    with pytest.raises(ParameterError, match="at least 0"):
        find_distance(Uniform(0.1, 1.0), 0.0, 0.0, -1.0)


def test_a_scene_does_not_care_about_its_scale() -> None:
    for name in MEDIA:
        small, large = MEDIA[name](0.02, 90.0), MEDIA[name](0.02 / 64.0, 90.0 * 64.0)
        depth = compute_optical_depth(small, numbers(30.0), numbers(0.2), 500.0)
        assert compute_optical_depth(large, numbers(30.0 * 64.0), numbers(0.2), 500.0 * 64.0) == depth
        assert compute_optical_depth(large, numbers(30.0), numbers(0.2), 500.0) != depth
