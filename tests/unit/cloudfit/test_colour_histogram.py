"""The batched counting loop against the plain definition: curve, round, count."""

import math

import pytest
import torch
from torch import Tensor

from cloudfit import colour_histogram as module
from cloudfit.colour_histogram import LEVELS, PIXELS_PER_BLOCK, colour_histogram, haze_histograms
from render.colour import DISPLAY_CURVES, srgb_to_linear
from render.errors import ParameterError

pytestmark = pytest.mark.usefixtures("loops")

CURVES = tuple(DISPLAY_CURVES)
LARGEST_MOVED_SHARE = 2e-3


def reference_levels(pixels: Tensor, display_curve: str) -> Tensor:
    """(pixel, channel) display levels as defined."""
    return (DISPLAY_CURVES[display_curve](pixels.double().clamp(0, 1)) * 255).round().long()


def reference_histogram(pixels: Tensor, display_curve: str) -> Tensor:
    """(channel, bin) shares by the plain definition."""
    levels = reference_levels(pixels, display_curve)
    counts = torch.stack([torch.bincount(channel, minlength=LEVELS) for channel in levels.T])
    return counts.double() / len(pixels)


def moved_share(first: Tensor, second: Tensor) -> float:
    """Largest share of pixels of a channel that one of two histograms has in a neighbouring level."""
    return float((first - second).cumsum(dim=-1).abs().sum(dim=-1).max())


def random_pixels(*shape: int, seed: int, power: float = 2.0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed)) ** power


@pytest.mark.parametrize("display_curve", CURVES)
@pytest.mark.parametrize("power", [0.5, 1.0, 2.2, 8.0])
def test_histogram_agrees_with_the_definition(display_curve: str, power: float) -> None:
    pixels = random_pixels(60_000, 3, seed=1, power=power) * 1.1
    expected = reference_histogram(pixels, display_curve)
    share = moved_share(colour_histogram(pixels, display_curve), expected)
    assert share < LARGEST_MOVED_SHARE
    # Truncation to the level below, or the other curve, would move every second pixel or more.
    truncated = reference_histogram((pixels - 0.5 / 255).clamp(min=0), "none")
    other = truncated if display_curve == "none" else reference_histogram(pixels, "none")
    assert moved_share(other, expected) > 100 * LARGEST_MOVED_SHARE


def test_borders_are_exact_without_a_curve() -> None:
    pixels = random_pixels(60_000, 3, seed=2, power=1.0)
    # One pixel in 60 000 may lie on a border to the last bit of float32; the tolerance of a curve would let 120 pass.
    assert moved_share(colour_histogram(pixels, "none"), reference_histogram(pixels, "none")) <= 5e-5


@pytest.mark.parametrize("display_curve", CURVES)
def test_borders_lie_within_a_250th_of_a_level(display_curve: str) -> None:
    middles = (torch.arange(255, dtype=torch.float64) + 0.5)[:, None]
    for side, level in ((-1, torch.arange(255)), (1, torch.arange(1, 256))):
        encoded = ((middles + side * 0.004) / 255).expand(-1, 3)
        linear = srgb_to_linear(encoded) if display_curve == "srgb" else encoded
        histogram = colour_histogram(linear.float().contiguous(), display_curve)
        expected = torch.bincount(level, minlength=LEVELS).double() / 255
        assert torch.equal(histogram, expected.expand(3, -1))


def test_an_8_bit_photograph_keeps_its_levels() -> None:
    levels = torch.randint(256, (5000, 3), generator=torch.Generator().manual_seed(3))
    expected = torch.stack([torch.bincount(channel, minlength=LEVELS) for channel in levels.T]) / 5000.0
    torch.testing.assert_close(colour_histogram(srgb_to_linear(levels / 255.0)), expected.double(), rtol=0, atol=1e-7)
    torch.testing.assert_close(colour_histogram(levels / 255.0, "none"), expected.double(), rtol=0, atol=1e-7)


@pytest.mark.parametrize("display_curve", CURVES)
@pytest.mark.parametrize("pixels", [1, 3, 4, 1000, PIXELS_PER_BLOCK + 1])
def test_haze_is_the_histogram_of_the_blended_image(display_curve: str, pixels: int) -> None:
    cloud, sky = random_pixels(4, 3, pixels, seed=4) * 1.5, random_pixels(3, pixels, seed=5)
    weights = torch.tensor([0.0, 0.25, 0.7, 1.0])
    histograms = haze_histograms(cloud, sky, weights, display_curve)
    assert histograms.shape == (4, 4, 3, LEVELS)
    assert histograms.dtype == torch.float64
    torch.testing.assert_close(histograms.sum(dim=-1), torch.ones(4, 4, 3, dtype=torch.float64))
    for candidate in range(4):
        for row, weight in enumerate(weights):
            image = (weight * cloud[candidate] + (1 - weight) * sky).T
            direct = colour_histogram(image, display_curve)
            # Only the rounding of the blend may differ; it is a ten-thousandth of a level.
            assert moved_share(histograms[candidate, row], direct) <= 2e-4


def test_the_ends_of_the_haze_are_cloud_and_sky_exactly() -> None:
    cloud, sky = random_pixels(2, 3, 5000, seed=6), random_pixels(3, 5000, seed=7)
    histograms = haze_histograms(cloud, sky, [1.0, 0.0])
    for candidate in range(2):
        assert torch.equal(histograms[candidate, 0], colour_histogram(cloud[candidate].T))
        assert torch.equal(histograms[candidate, 1], colour_histogram(sky.T))
    assert moved_share(histograms[0, 0], histograms[0, 1]) > 0.1


def test_every_candidate_and_channel_may_have_air_of_its_own() -> None:
    cloud, sky = random_pixels(3, 3, 5000, seed=15), random_pixels(3, 5000, seed=16)
    weights = torch.rand(3, 4, 3, generator=torch.Generator().manual_seed(17))
    weights[0, 0], weights[1, 1] = 1.0, 0.0
    histograms = haze_histograms(cloud, sky, weights)
    assert histograms.shape == (3, 4, 3, LEVELS)
    for candidate in range(3):
        for channel in range(3):
            shared = haze_histograms(cloud, sky, weights[candidate, :, channel])
            assert torch.equal(histograms[candidate, :, channel], shared[candidate, :, channel])
            wrong = shared[(candidate + 1) % 3, :, (channel + 1) % 3]
            assert not torch.equal(histograms[candidate, :, channel], wrong)
    assert torch.equal(histograms[0, 0], colour_histogram(cloud[0].T))
    assert torch.equal(histograms[1, 1], colour_histogram(sky.T))


def test_threads_and_blocks_do_not_change_a_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    cloud, sky = random_pixels(3, 3, 5000, seed=8), random_pixels(3, 5000, seed=9)
    weights = torch.linspace(0, 1, 11)
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        expected = haze_histograms(cloud, sky, weights)
        torch.set_num_threads(3)
        assert torch.equal(haze_histograms(cloud, sky, weights), expected)
        monkeypatch.setattr(module, "PIXELS_PER_BLOCK", 777)
        assert torch.equal(haze_histograms(cloud, sky, weights), expected)
    finally:
        torch.set_num_threads(before)


def test_the_look_up_for_older_opencv_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    cloud, sky = random_pixels(2, 3, 3000, seed=10), random_pixels(3, 3000, seed=11)
    expected = haze_histograms(cloud, sky, [0.5, 1.0])

    def refuse(*_: object) -> None:
        raise module.cv2.error("16-bit look-up is not supported")

    monkeypatch.setattr(module, "_look_up_by_opencv", refuse)
    monkeypatch.setattr(module, "_look_up_levels", module._choose_look_up())
    assert module._look_up_levels is module._look_up_by_numpy
    assert torch.equal(haze_histograms(cloud, sky, [0.5, 1.0]), expected)


def test_values_outside_the_display_go_to_its_ends() -> None:
    for value, level in ((-1e30, 0), (-0.1, 0), (0.0, 0), (1.0, 255), (1.7, 255), (3e38, 255)):
        histogram = colour_histogram(torch.full((7, 3), value))
        assert float(histogram[:, level].min()) == 1.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_makes_its_channel_nan(value: float) -> None:
    cloud, sky = random_pixels(3, 3, 50, seed=12), random_pixels(3, 50, seed=13)
    clean = haze_histograms(cloud, sky, [0.0, 0.5])
    cloud[1, 2, 7] = value
    histograms = haze_histograms(cloud, sky, [0.0, 0.5])
    spoilt = histograms.isnan().all(dim=-1)
    assert bool(spoilt[1, :, 2].all())
    assert int(spoilt.sum()) == 2
    assert torch.equal(histograms[~spoilt], clean[~spoilt])
    sky[0, 3] = value
    assert bool(haze_histograms(cloud, sky, [0.5])[:, :, 0].isnan().all())


def test_opposite_infinities_do_not_hide_each_other() -> None:
    pixels = torch.zeros(5, 3)
    pixels[0, 0], pixels[1, 0] = math.inf, -math.inf
    assert bool(colour_histogram(pixels)[0].isnan().all())


def test_gradients_are_no_obstacle_and_strides_neither() -> None:
    pixels = random_pixels(3, 100, seed=14).requires_grad_()
    assert torch.equal(colour_histogram(pixels.T), colour_histogram(pixels.detach().T.contiguous()))


def test_wrong_arguments_are_named() -> None:
    cloud, sky = torch.zeros(2, 3, 10), torch.zeros(3, 10)
    with pytest.raises(ParameterError, match=r"\(2, 3, 10\) and \(3, 9\)"):
        haze_histograms(cloud, sky[:, :9], [1.0])
    with pytest.raises(ParameterError, match="one or more pixels"):
        haze_histograms(cloud[:, :, :0], sky[:, :0], [1.0])
    own = torch.full((2, 4, 3), 0.5)
    for weights in ([1.1], [-0.1], [math.nan], [], [[1.0]], [0.5] * 257, own[:1], own[:, :0], own[:, :, :2], own * 3):
        with pytest.raises(ParameterError, match="haze_weights"):
            haze_histograms(cloud, sky, torch.as_tensor(weights))
    with pytest.raises(ParameterError, match=r"srgb, none.*'film'"):
        haze_histograms(cloud, sky, [1.0], "film")
    for shape in ((10, 4), (0, 3), (3,)):
        with pytest.raises(ParameterError, match="pixels: expected"):
            colour_histogram(torch.zeros(shape))
