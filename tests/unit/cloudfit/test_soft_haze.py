"""Soft histograms behind haze, with the torch loop and with its fused twin."""

import pytest
import torch

from cloudfit.colour_histogram import haze_histograms
from cloudfit.losses.soft_histogram import soft_histogram
from cloudfit.soft_haze import display_values, soft_haze_histograms
from render.cloud_image import blend_air


@pytest.mark.parametrize("curve", ["srgb", "none"])
def test_display_values_are_those_that_histograms_count(curve: str) -> None:
    linear = 1.4 * torch.rand(2, 3, 50, generator=torch.Generator().manual_seed(0)) - 0.2
    values = display_values(linear, curve)
    assert values.shape == linear.shape
    counted = haze_histograms(linear, torch.zeros(3, 50), (1.0,), curve)[:, 0]
    levels = (255.0 * values).round().long()
    # Borders of levels are tabulated: a pixel in a thousand may take the neighbour.
    assert float((counted - torch.nn.functional.one_hot(levels, 256).sum(2).double() / 50).abs().sum()) <= 2 * 2 / 50
    # A count that three does not divide.
    torch.testing.assert_close(display_values(linear[0, 0, :7], curve), values[0, 0, :7])


@pytest.mark.usefixtures("loops")
@pytest.mark.parametrize("curve", ["srgb", "none"])
@pytest.mark.parametrize("pixels", [1, 7, 5000])
def test_every_pixel_is_shared_by_the_levels_next_to_it(curve: str, pixels: int) -> None:
    generator = torch.Generator().manual_seed(0)
    cloud = 1.4 * torch.rand(2, 3, pixels, generator=generator) - 0.2
    sky = torch.rand(3, pixels, generator=generator)
    depth = torch.rand(2, 4, 3, generator=generator, dtype=torch.float64)
    depth[:, 0] = 0.0
    found = soft_haze_histograms(cloud, sky, depth, curve)
    assert found.shape == (2, 4, 3, 256)
    torch.testing.assert_close(found.sum(-1), torch.ones(2, 4, 3, dtype=torch.float64), rtol=0, atol=1e-6)
    for kappa in range(4):
        image = blend_air(cloud, sky, depth[:, kappa].float())
        expected = soft_histogram(display_values(image, curve))
        # Each pixel lies within half a step of its place, and moves at most twice as much of itself.
        assert float((found[:, kappa] - expected).abs().sum(-1).max()) < 2.0 / 250.0
        hard = haze_histograms(cloud, sky, torch.exp(-depth[:, kappa : kappa + 1]), curve)[:, 0]
        assert float((hard - expected).abs().sum(-1).max()) > 0.05
