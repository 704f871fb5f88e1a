import math

import pytest
import torch
from kornia.metrics import ssim

from render.colour import linear_to_srgb
from render.errors import ParameterError
from render.image_error import compute_image_error
from render.random_streams import child_generator


def picture(seed: int = 1) -> torch.Tensor:
    smooth = torch.rand(1, 3, 8, 10, generator=child_generator(seed))
    return torch.nn.functional.interpolate(smooth, (32, 40), mode="bicubic")[0].permute(1, 2, 0).clamp(0.0, 1.0)


def test_an_image_has_no_error_against_itself() -> None:
    error = compute_image_error(picture(), picture())
    assert (error.relative_rms, error.largest) == (0.0, 0.0)
    assert error.dissimilarity == pytest.approx(0.0, abs=1e-6)


def test_errors_of_light_have_their_closed_form() -> None:
    """Two of three values of 3, 4 and 0 are off by 1."""
    truth = torch.tensor([[[3.0, 4.0, 0.0]]])
    error = compute_image_error(truth + torch.tensor([[[1.0, 0.0, -1.0]]]), truth)
    assert error.relative_rms == pytest.approx(math.sqrt(2.0) / 5.0)
    assert error.largest == pytest.approx(0.25)


def test_brightness_does_not_matter_and_the_order_does() -> None:
    image, truth = picture(2), picture(1)
    error = compute_image_error(image, truth)
    dim = compute_image_error(1e-3 * image, 1e-3 * truth, exposure=1e3)
    assert dim.relative_rms == pytest.approx(error.relative_rms, rel=1e-5)
    assert dim.largest == pytest.approx(error.largest, rel=1e-5)
    assert dim.dissimilarity == pytest.approx(error.dissimilarity, rel=1e-3)
    assert compute_image_error(truth, 0.5 * image).relative_rms != pytest.approx(error.relative_rms, rel=0.05)


def test_structure_is_compared_by_means_variances_and_covariance_as_displayed() -> None:
    """The formula of the paper at one pixel in the middle of a large image of one window's pattern."""
    generator = child_generator(3)
    truth, image = torch.rand(2, 11, 11, 1, generator=generator).expand(-1, -1, -1, 3)
    big = [torch.nn.functional.pad(x.permute(2, 0, 1)[None], (11,) * 4, mode="circular")[0] for x in (truth, image)]
    offset = torch.arange(11) - 5.0
    weight = torch.exp(-0.5 * (offset / 1.5).square())
    window = weight[:, None] * weight / weight.sum() ** 2
    shown = [linear_to_srgb(x.permute(1, 2, 0))[..., 0].double() for x in big]
    values = []
    for row, column in ((15, 15), (20, 27), (12, 26)):
        a, b = (x[row - 5 : row + 6, column - 5 : column + 6] for x in shown)
        mean_a, mean_b = (window * a).sum(), (window * b).sum()
        var_a, var_b = (window * a * a).sum() - mean_a**2, (window * b * b).sum() - mean_b**2
        covariance = (window * a * b).sum() - mean_a * mean_b
        values.append(
            (2 * mean_a * mean_b + 1e-4) * (2 * covariance + 9e-4)
            / ((mean_a**2 + mean_b**2 + 1e-4) * (var_a + var_b + 9e-4))
        )  # fmt: skip
    found = ssim(*(x[None].float()[None] for x in shown), 11)[0, 0]
    assert [found[r, c].item() for r, c in ((15, 15), (20, 27), (12, 26))] == pytest.approx(
        [v.item() for v in values], abs=1e-4
    )
    error = compute_image_error(big[1].permute(1, 2, 0), big[0].permute(1, 2, 0))
    assert error.dissimilarity == pytest.approx(1.0 - found.double().mean().item(), rel=1e-6)


def test_a_shift_of_brightness_is_less_unlike_than_noise_of_the_same_size() -> None:
    truth = 0.2 + 0.5 * picture()
    noise = 0.05 * (torch.randint(0, 2, truth.shape, generator=child_generator(4)) * 2 - 1)
    shifted, noisy = compute_image_error(truth + 0.05, truth), compute_image_error(truth + noise, truth)
    assert shifted.relative_rms == pytest.approx(noisy.relative_rms, rel=1e-4)
    assert noisy.dissimilarity > 3.0 * shifted.dissimilarity > 0.0


def test_small_and_black_images_have_errors_too() -> None:
    one = torch.full((1, 1, 3), 0.5)
    assert compute_image_error(one, one).dissimilarity == pytest.approx(0.0, abs=1e-6)
    black = torch.zeros(4, 5, 3)
    assert compute_image_error(black, black).relative_rms == 0.0
    assert compute_image_error(black + 0.1, black).relative_rms == math.inf
    assert compute_image_error(black, black + 0.1).largest == pytest.approx(1.0)


def test_what_cannot_be_compared_is_refused() -> None:
    with pytest.raises(ParameterError, match="two images"):
        compute_image_error(torch.ones(4, 4, 3), torch.ones(4, 5, 3))
    with pytest.raises(ParameterError, match="finite"):
        compute_image_error(torch.full((4, 4, 3), math.nan), torch.ones(4, 4, 3))
    with pytest.raises(ParameterError, match="exposure"):
        compute_image_error(torch.ones(4, 4, 3), torch.ones(4, 4, 3), exposure=0.0)
