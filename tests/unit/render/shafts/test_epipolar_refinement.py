import math

import pytest
import torch

from render.errors import ParameterError
from render.fused import torch_loops_only
from render.random_streams import child_generator
from render.shafts.epipolar_refinement import halve_gaps, separate_pixels, spread_of_pixels
from render.shafts.epipolar_sampling import EpipolarSettings
from tests.unit.render.shafts.test_epipolar import pixel_centres
from tests.unit.render.shafts.test_epipolar_sampling import boxes, sample


def shadow(points: torch.Tensor) -> torch.Tensor:
    """Light that ends at a slanted border."""
    return torch.where(points[:, :1] + 0.3 * points[:, 1:] < 23.0, 1.0, 0.2)


SETTINGS = EpipolarSettings(line_gap=1.0, stride=16)


def test_halving_finds_the_border_with_few_rays() -> None:
    sampling = sample("off the frame", settings=SETTINGS)
    values = shadow(sampling.points[sampling.marched])
    first = len(values)
    for _ in range(5):
        refined = halve_gaps(sampling, values, 0.1)
        sampling = refined.sampling
        values = refined.merge(values, shadow(sampling.points[sampling.marched[refined.fresh]]))
    assert not bool(refined.fresh.any())
    assert torch.equal(values, shadow(sampling.points[sampling.marched]))
    dense = sampling.interpolate_lines(values)
    assert torch.allclose(dense, shadow(sampling.points))
    assert first < len(values) < first + 5 * sampling.lines.lines
    coarse = sample("off the frame", settings=SETTINGS)
    assert not torch.allclose(
        coarse.interpolate_lines(shadow(coarse.points[coarse.marched])), shadow(sampling.points), atol=0.1
    )


def test_gaps_of_like_light_stay_open() -> None:
    sampling = sample("off the frame", settings=SETTINGS)
    values = 0.001 * sampling.points[sampling.marched]
    assert not bool(halve_gaps(sampling, values, 0.05).fresh.any())
    assert bool(halve_gaps(sampling, values, 0.005).fresh.any())


def test_edges_of_depth_are_no_gaps() -> None:
    """What is constant on each surface needs no more rays, however much it differs between them."""
    sampling = sample("in the middle", boxes(child_generator(2)), SETTINGS)
    values = torch.atan(sampling.depth[sampling.marched][:, None])
    assert not bool(halve_gaps(sampling, values, 0.0).fresh.any())


def test_pixels_at_the_border_are_separated() -> None:
    sampling = sample("off the frame", settings=EpipolarSettings(line_gap=3.0, stride=1))
    values = shadow(sampling.points[sampling.marched])
    apart = separate_pixels(sampling, values, 0.1)
    exact = shadow(pixel_centres().float())
    image = apart.interpolate(values, exact[apart.own_pixels])
    assert torch.allclose(image, exact, atol=0.1)
    assert 0 < len(apart.own_pixels) < 0.15 * len(exact)
    assert not torch.allclose(sampling.interpolate(values, values[:0]), exact, atol=0.1)
    assert len(separate_pixels(sampling, values, 0.9).own_pixels) == 0


def test_pixels_of_their_own_stay_so_and_have_no_spread() -> None:
    depth = torch.full((24, 40), 50.0)
    depth[11, 17] = 3.0
    sampling = sample("off the frame", depth, EpipolarSettings(line_gap=4.0, sample_gap=4.0))
    values = torch.ones(len(sampling.marched), 2)
    assert separate_pixels(sampling, values, 0.1).own_pixels.tolist() == [11 * 40 + 17]


def test_the_fused_spread_is_the_one_in_torch() -> None:
    pytest.importorskip("numba")
    sampling = sample("in a corner", boxes(child_generator(2)), SETTINGS)
    dense = torch.rand(len(sampling.points), 3, generator=child_generator(5))
    found = spread_of_pixels(dense, sampling.pixel_samples, sampling.pixel_weights)
    with torch_loops_only():
        expected = spread_of_pixels(dense, sampling.pixel_samples, sampling.pixel_weights)
    torch.testing.assert_close(found, expected)
    assert float(found.max()) > 0.5


def test_what_does_not_fit_is_refused() -> None:
    sampling = sample("in a corner", settings=SETTINGS)
    values = torch.zeros(len(sampling.marched), 1)
    with pytest.raises(ParameterError, match="values of 3"):
        halve_gaps(sampling, values[:3], 0.1)
    with pytest.raises(ParameterError, match="contrast"):
        separate_pixels(sampling, values, math.nan)
