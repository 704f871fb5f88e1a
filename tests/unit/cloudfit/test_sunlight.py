import pytest
import torch

from cloudfit.cloud_mask import CloudMask, Label
from cloudfit.sunlight import estimate_sunlight

WARM, SHADE, BLUE = torch.tensor([0.9, 0.8, 0.6]), torch.tensor([0.2, 0.22, 0.25]), torch.tensor([0.1, 0.25, 0.5])


def two_tone(share: float = 0.3) -> tuple[torch.Tensor, CloudMask]:
    """Cloud of which `share` is sunlit, above clear sky."""
    pixels = BLUE.expand(20, 100, 3).clone()
    pixels[:10] = SHADE
    pixels[:10, : int(100 * share)] = WARM
    labels = torch.full((20, 100), Label.SKY, dtype=torch.uint8)
    labels[:10] = Label.CLOUD
    return pixels, CloudMask(labels)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.8])
def test_the_brighter_class_gives_the_colour(share):
    sunlight = estimate_sunlight(*two_tone(share))
    torch.testing.assert_close(sunlight.colour, WARM / 0.9)
    assert sunlight.bright_fraction == pytest.approx(share)
    assert float(SHADE.mean()) - 0.01 <= sunlight.grey_threshold < float(WARM.mean())
    torch.testing.assert_close(sunlight.ambient_sky_colour, BLUE / 0.5)


def test_the_mean_of_all_cloud_would_be_another_colour():
    pixels, mask = two_tone()
    mean = pixels[mask.cloud].mean(dim=0)
    assert float((mean / mean.max() - estimate_sunlight(pixels, mask).colour).abs().max()) > 0.03


def test_clear_sky_and_landscape_do_not_count():
    pixels, mask = two_tone()
    expected = estimate_sunlight(pixels, mask)
    pixels = pixels.clone()
    labels = mask.labels.clone()
    pixels[15:], labels[15:] = torch.tensor([1.0, 0.0, 0.0]), Label.OTHER
    found = estimate_sunlight(pixels, CloudMask(labels))
    torch.testing.assert_close(found.colour, expected.colour)
    torch.testing.assert_close(found.ambient_sky_colour, expected.ambient_sky_colour)


@pytest.mark.parametrize("value", [0.0, 0.3, 1.0])
def test_a_cloud_of_one_grey(value):
    mask = CloudMask(torch.full((4, 5), Label.CLOUD, dtype=torch.uint8))
    sunlight = estimate_sunlight(torch.full((4, 5, 3), value), mask)
    assert sunlight.colour.tolist() == [1.0, 1.0, 1.0]
    assert sunlight.bright_fraction == 1.0
    # No sky in sight: the sun's colour stands in.
    assert torch.equal(sunlight.ambient_sky_colour, sunlight.colour)


def test_the_sun_seen_through_a_cloud_does_not_outweigh_it():
    pixels, mask = two_tone()
    pixels = pixels.clone()
    pixels[0, 0] = torch.tensor([6e4, 1e4, 1e2])
    colour = estimate_sunlight(pixels, mask).colour
    torch.testing.assert_close(colour, WARM / 0.9, atol=0.01, rtol=0.0)


def test_a_mask_without_cloud_is_refused():
    pixels, mask = two_tone()
    with pytest.raises(ValueError, match="cloud"):
        estimate_sunlight(pixels, CloudMask(torch.full_like(mask.labels, Label.SKY)))
