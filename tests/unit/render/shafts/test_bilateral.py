import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from render.errors import ParameterError
from render.random_streams import child_generator
from render.shafts.bilateral import TAP_COUNTS, ReducedFrame, fill_frame, filter_image


def reduce(image: torch.Tensor, frame: ReducedFrame) -> torch.Tensor:
    return image[frame.rows][:, frame.columns]


def two_surfaces(height: int, width: int, generator: torch.Generator) -> torch.Tensor:
    """A wall at 10 m with a bent edge before the sky."""
    edge = 0.5 * width + 3.0 * torch.sin(torch.arange(height) / 3.0)
    return torch.where(torch.arange(width) < edge[:, None], 10.0, torch.inf)


def test_marched_pixels_are_the_middles_of_blocks() -> None:
    frame = ReducedFrame(10, 7, 4)
    assert frame.columns.tolist() == [2, 6, 9]
    assert frame.rows.tolist() == [2, 6]
    assert frame.pixels().tolist() == [22, 26, 29, 62, 66, 69]


@pytest.mark.parametrize("taps", [1, 2])
def test_at_full_resolution_with_no_radius_nothing_changes(taps: int) -> None:
    image = torch.rand(9, 13, 3, generator=child_generator(1))
    depth = 1.0 + torch.rand(9, 13, generator=child_generator(2))
    assert torch.equal(filter_image(image, depth, taps), image)
    assert not torch.allclose(filter_image(image, depth, 4), image, atol=0.01)


@pytest.mark.parametrize("taps", TAP_COUNTS)
@given(st.integers(1, 30), st.integers(1, 30), st.integers(1, 6), st.integers(0, 2**32))
@settings(max_examples=15, deadline=None)
def test_constants_stay_constant(taps: int, width: int, height: int, factor: int, seed: int) -> None:
    """On any depths, edges and sky included."""
    depth = (3.0 * torch.randn(height, width, generator=child_generator(seed))).exp()
    depth = torch.where(depth > 20.0, torch.inf, depth)
    frame = ReducedFrame(width, height, factor)
    marched = torch.full((len(frame.rows), len(frame.columns), 2), 0.7)
    assert torch.allclose(fill_frame(frame, marched, depth, taps).image, torch.tensor(0.7), atol=1e-6)


@pytest.mark.parametrize("taps", TAP_COUNTS)
def test_edges_of_depth_are_kept(taps: int) -> None:
    depth = two_surfaces(24, 40, child_generator(3))
    image = torch.where(torch.isinf(depth), 1.0, 0.25)[..., None]
    frame = ReducedFrame(40, 24, 4)
    filled = fill_frame(frame, reduce(image, frame), depth, taps)
    right = (filled.image - image).abs()[..., 0] < 1e-6
    assert bool((right | filled.unmatched).all())
    assert float(filled.unmatched.float().mean()) < (0.05 if taps < 4 else 0.02)
    blind = fill_frame(frame, reduce(image, frame), torch.ones_like(depth), taps)
    assert not bool(blind.unmatched.any())
    assert float((blind.image - image).abs().max()) > 0.3


def test_a_pixel_that_is_nearer_than_all_marched_ones_is_reported() -> None:
    depth = torch.full((12, 12), 100.0)
    depth[3, 5] = 2.0
    filled = fill_frame(ReducedFrame(12, 12, 4), torch.ones(3, 3, 1), depth, 4)
    assert torch.nonzero(filled.unmatched).tolist() == [[3, 5]]
    depth[3, 5] = 105.0
    assert not bool(fill_frame(ReducedFrame(12, 12, 4), torch.ones(3, 3, 1), depth, 4).unmatched.any())


def test_two_taps_interpolate_linearly_between_marched_pixels() -> None:
    row, column = torch.meshgrid(torch.arange(19.0), torch.arange(26.0), indexing="ij")
    image = (2.0 + 0.5 * column - 0.25 * row + 0.1 * row * column)[..., None]
    frame = ReducedFrame(26, 19, 4)
    filled = fill_frame(frame, reduce(image, frame), torch.full((19, 26), 5.0), 2).image
    inner = (slice(2, int(frame.rows[-1]) + 1), slice(2, int(frame.columns[-1]) + 1))
    assert torch.allclose(filled[inner], image[inner], atol=1e-4)
    nearest = fill_frame(frame, reduce(image, frame), torch.full((19, 26), 5.0), 1).image
    assert not torch.allclose(nearest[inner], image[inner], atol=0.1)


def test_the_weights_are_those_of_the_formula() -> None:
    """One row, four taps around the pixel between the second and the third marched one."""
    depth = torch.tensor([[5.0, 5.0, 5.2, 5.0, 5.1, 5.0, 5.0]])
    frame = ReducedFrame(7, 1, 2)
    assert frame.columns.tolist() == [1, 3, 5, 6]
    values = torch.tensor([0.1, 0.4, 0.7, 0.9])
    filled = fill_frame(frame, values.reshape(1, 4, 1), depth, 4).image
    weights = [
        math.exp(-0.5 * (x / 2.0) ** 2) * math.exp(-0.5 * (math.log(5.1 / 5.0) / math.log(1.1)) ** 2)
        for x in (3.0, 1.0, 1.0, 2.0)
    ]
    expected = sum(w * v for w, v in zip(weights, values.tolist(), strict=True)) / sum(weights)
    assert filled[0, 4, 0].item() == pytest.approx(expected, rel=1e-5)
    narrow = fill_frame(frame, values.reshape(1, 4, 1), depth, 8).image
    assert narrow[0, 4, 0].item() != pytest.approx(expected, rel=1e-3)


def test_the_two_passes_treat_rows_and_columns_alike() -> None:
    generator = child_generator(5)
    image, depth = torch.rand(24, 24, 3, generator=generator), torch.rand(24, 24, generator=generator) + 5.0
    frame = ReducedFrame(24, 24, 3)
    smooth = fill_frame(frame, reduce(image, frame), torch.full_like(depth, 5.0), 8).image
    turned = fill_frame(frame, reduce(image.transpose(0, 1), frame), torch.full_like(depth, 5.0), 8).image
    assert torch.allclose(smooth, turned.transpose(0, 1), atol=1e-5)
    assert not torch.allclose(smooth, turned, atol=1e-2)


def test_more_taps_take_more_noise_away() -> None:
    noise = torch.randn(64, 64, 1, generator=child_generator(6))
    deviation = [
        float(filter_image(noise, torch.full((64, 64), 3.0), taps)[16:48, 16:48].std()) for taps in TAP_COUNTS[1:]
    ]
    assert deviation == sorted(deviation, reverse=True)
    assert deviation[0] > 10.0 * deviation[-1]


def test_a_pixel_without_a_like_tap_takes_the_nearest_depth() -> None:
    depth = torch.full((1, 9), math.inf)
    depth[0, 1], depth[0, 4], depth[0, 7], depth[0, 3] = 10.0, 90.0, math.inf, 80.0
    values = torch.tensor([[[1.0], [2.0], [3.0]]])
    filled = fill_frame(ReducedFrame(9, 1, 3), values, depth, 2, depth_tolerance=1e-3).image
    assert filled[0, 3, 0].item() == 2.0
    assert filled[0, 2, 0].item() in (1.0, 2.0)
    assert filled[0, 5, 0].item() == 3.0


def test_what_does_not_fit_is_refused() -> None:
    frame, depth = ReducedFrame(8, 8, 2), torch.ones(8, 8)
    with pytest.raises(ParameterError, match="taps"):
        fill_frame(frame, torch.ones(4, 4, 3), depth, 3)
    with pytest.raises(ParameterError, match="marched pixels"):
        fill_frame(frame, torch.ones(8, 8, 3), depth, 4)
    with pytest.raises(ParameterError, match="tolerance"):
        fill_frame(frame, torch.ones(4, 4, 3), depth, 4, depth_tolerance=0.0)
    with pytest.raises(ParameterError, match="one pixel"):
        ReducedFrame(8, 8, 0)
