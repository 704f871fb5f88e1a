import numpy as np
import pytest
import torch
from torch import Tensor

from cloudfit.cloud_mask import CloudMask, Label
from cloudfit.sky_fill import HIDDEN_SKY_LUMINANCE, default_growth, fill_sky
from render.colour import luminance
from tests.support.sky_scenes import cloudy_scene


def ramp(height: int, width: int) -> Tensor:
    """Sky that is linear in both directions, hence harmonic."""
    y, x = torch.meshgrid(torch.arange(height) / height, torch.arange(width) / width, indexing="ij")
    return torch.stack([0.2 + 0.3 * y + 0.1 * x, 0.3 + 0.2 * y, 0.8 - 0.2 * x - 0.1 * y], dim=-1).float()


def labelled(
    height: int, width: int, cloud: tuple[slice, slice], other: tuple[slice, slice] | None = None
) -> CloudMask:
    labels = torch.full((height, width), Label.SKY, dtype=torch.uint8)
    labels[cloud] = Label.CLOUD
    if other is not None:
        labels[other] = Label.OTHER
    return CloudMask(labels)


@pytest.mark.parametrize(("height", "width"), [(60, 90), (250, 200)])
def test_a_linear_sky_is_reproduced_behind_a_cloud(height, width):
    sky = ramp(height, width)
    mask = labelled(height, width, (slice(20, 40), slice(30, 60)))
    pixels = torch.where(mask.cloud[..., None], 1.0, sky)
    torch.testing.assert_close(fill_sky(pixels, mask, grow=0), sky, atol=1e-6, rtol=0.0)


def test_a_linear_sky_is_reproduced_on_nested_grids():
    sky = ramp(400, 700)
    mask = labelled(400, 700, (slice(100, 300), slice(150, 500)))
    pixels = torch.where(mask.cloud[..., None], 1.0, sky)
    error = (fill_sky(pixels, mask, grow=0) - sky).abs()
    assert float(error.max()) < 2e-3
    assert float(error.square().mean().sqrt()) < 3e-4
    # The mean of the visible sky, a cruder fill, is far off.
    assert float((sky[~mask.cloud].mean(dim=0) - sky)[mask.cloud].abs().max()) > 0.05


def test_the_fill_stays_between_the_darkest_and_the_brightest_sky():
    generator = torch.Generator().manual_seed(0)
    pixels = torch.rand(80, 120, 3, generator=generator)
    mask = labelled(80, 120, (slice(10, 60), slice(30, 110)))
    filled = fill_sky(pixels, mask, grow=0)
    seen = pixels[mask.sky]
    assert (filled.amin(dim=(0, 1)) >= seen.amin(dim=0) - 1e-6).all()
    assert (filled.amax(dim=(0, 1)) <= seen.amax(dim=0) + 1e-6).all()


def test_a_filled_pixel_is_the_mean_of_its_neighbours():
    pixels = torch.rand(40, 50, 3, generator=torch.Generator().manual_seed(0))
    filled = fill_sky(pixels, labelled(40, 50, (slice(10, 30), slice(15, 35))), grow=0)
    neighbours = (filled[:-2, 1:-1] + filled[2:, 1:-1] + filled[1:-1, :-2] + filled[1:-1, 2:]) / 4.0
    torch.testing.assert_close(filled[11:29, 16:34], neighbours[10:28, 15:33], atol=1e-5, rtol=0.0)


def test_no_flux_leaves_through_the_edge_of_the_picture():
    # Sky known on the left alone: nothing flows, so its value fills everything up to the right edge.
    pixels = torch.rand(30, 40, 3, generator=torch.Generator().manual_seed(0))
    pixels[:, :5] = torch.tensor([0.2, 0.4, 0.8])
    filled = fill_sky(pixels, labelled(30, 40, (slice(None), slice(5, None))), grow=0)
    torch.testing.assert_close(filled, torch.tensor([0.2, 0.4, 0.8]).expand(30, 40, 3), atol=1e-5, rtol=0.0)


def test_landscape_neither_leaks_nor_remains():
    sky = ramp(100, 120)
    mask = labelled(100, 120, (slice(50, 70), slice(30, 90)), other=(slice(70, None), slice(None)))
    pixels = torch.where(mask.cloud[..., None], 1.0, sky)
    pixels[70:] = torch.tensor([0.0, 5.0, 0.0])
    filled = fill_sky(pixels, mask, grow=0)
    assert float(filled[..., 1].max()) <= float(sky[:70, :, 1].max()) + 1e-6
    # With the landscape taken for sky it does leak into the cloud above it.
    leaking = CloudMask(torch.where(mask.other, torch.full_like(mask.labels, Label.SKY), mask.labels))
    assert float(fill_sky(pixels, leaking, grow=0)[60:70, 40:80, 1].max()) > 1.0


def test_growing_keeps_the_rim_of_a_cloud_out_of_the_sky():
    sky = ramp(100, 120)
    mask = labelled(100, 120, (slice(40, 60), slice(40, 80)))
    rim = labelled(100, 120, (slice(37, 63), slice(37, 83))).cloud
    pixels = torch.where(rim[..., None], 1.0, sky)
    ghost = (fill_sky(pixels, mask, grow=0) - sky).abs().max()
    clean = (fill_sky(pixels, mask, grow=4) - sky).abs().max()
    assert float(ghost) > 0.3
    assert float(clean) < 1e-5


def test_growing_stops_before_it_leaves_no_sky():
    pixels, _, _ = cloudy_scene(40, 60)
    mask = labelled(40, 60, (slice(5, None), slice(None)))
    filled = fill_sky(pixels, mask, grow=30)
    assert torch.isfinite(filled).all()
    seen = pixels[:5].reshape(-1, 3)
    assert (filled.reshape(-1, 3) <= seen.amax(dim=0) + 1e-5).all()


def test_visible_sky_is_returned_as_it_is():
    pixels, cloud, ground = cloudy_scene()
    labels = torch.where(cloud, int(Label.CLOUD), torch.where(ground, int(Label.OTHER), int(Label.SKY)))
    filled = fill_sky(pixels, CloudMask(labels.to(torch.uint8)), grow=0)
    seen = ~cloud & ~ground
    torch.testing.assert_close(filled[seen], pixels[seen])
    assert float((filled[cloud] - pixels[cloud]).abs().mean()) > 0.2


def test_a_picture_without_sky_gets_a_bluish_half_as_bright_guess():
    pixels = torch.full((20, 30, 3), 0.6)
    filled = fill_sky(pixels, labelled(20, 30, (slice(None), slice(None))), grow=3)
    assert (filled == filled[0, 0]).all()
    assert float(luminance(filled[0, 0])) == pytest.approx(0.6 * HIDDEN_SKY_LUMINANCE, rel=0.01)
    assert filled[0, 0, 2] > filled[0, 0, 1] > filled[0, 0, 0]


def test_a_picture_of_sky_alone_is_left_alone():
    sky = ramp(20, 30)
    mask = CloudMask(torch.full((20, 30), Label.SKY, dtype=torch.uint8))
    assert torch.equal(fill_sky(sky, mask, grow=5), sky)


def test_one_pixel_of_sky_fills_all():
    pixels = torch.rand(7, 9, 3, generator=torch.Generator().manual_seed(0))
    labels = torch.full((7, 9), Label.CLOUD, dtype=torch.uint8)
    labels[3, 4] = Label.SKY
    filled = fill_sky(pixels, CloudMask(labels), grow=2)
    torch.testing.assert_close(filled, pixels[3, 4].expand(7, 9, 3), atol=1e-5, rtol=0.0)


def test_default_growth_follows_the_size():
    assert default_growth(768, 1024) == 36
    assert default_growth(1, 1) == 1
    assert np.all(np.diff([default_growth(s, s) for s in (100, 500, 1000)]) > 0)
