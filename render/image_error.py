"""How far an image is from the true one: in light, at its worst pixel, and as seen.

The errors of light are relative to the truth as a whole, so that they mean the same for a dim scene and a bright one, and dark pixels
do not count more than bright ones. The structural similarity of Wang, Bovik, Sheikh & Simoncelli 2004, "Image quality assessment: from
error visibility to structural similarity", compares the images as displayed.
"""

from dataclasses import dataclass

import torch
from kornia.metrics import ssim
from torch import Tensor

from render.colour import linear_to_srgb
from render.errors import ParameterError

SSIM_WINDOW = 11
"""Side of the Gaussian window [pixels], as in the paper."""


@dataclass(frozen=True)
class ImageError:
    """Errors of an image.

    Args:
        relative_rms: root of the mean squared difference over the root of the mean squared truth.
        largest: largest difference of any pixel and channel over the largest value of the truth.
        dissimilarity: 1 - mean structural similarity of the displayed images, 0 for equal ones.
    """

    relative_rms: float
    largest: float
    dissimilarity: float


def compute_image_error(image: Tensor, truth: Tensor, exposure: float = 1.0) -> ImageError:
    """Compare an image with the true one.

    Args:
        image, truth: linear light `(height, width, 3)`.
        exposure: factor that brings the light to the display's white, for the dissimilarity.

    Returns:
        The errors; infinite for an error of light where the truth is black throughout and the image is not.

    Raises:
        ParameterError: for images of different shapes or without pixels, values that are not finite, or an exposure that is not
            positive.
    """
    if image.shape != truth.shape or image.ndim != 3 or image.shape[2] != 3 or not image.numel():
        raise ParameterError(
            f"two images (height, width, 3) are compared, not {tuple(image.shape)}, {tuple(truth.shape)}"
        )
    if not bool((torch.isfinite(image) & torch.isfinite(truth)).all()):
        raise ParameterError("images to compare must be finite throughout")
    if not 0.0 < exposure < float("inf"):
        raise ParameterError(f"the exposure must be positive, not {exposure}")
    difference = image.double() - truth.double()
    rms, size = float(difference.square().mean().sqrt()), float(truth.double().square().mean().sqrt())
    worst, brightest = float(difference.abs().max()), float(truth.double().abs().max())
    return ImageError(_ratio(rms, size), _ratio(worst, brightest), _dissimilarity(image * exposure, truth * exposure))


def _ratio(error: float, size: float) -> float:
    if error == 0.0:
        return 0.0
    return error / size if size > 0.0 else float("inf")


def _dissimilarity(image: Tensor, truth: Tensor) -> float:
    shown = [linear_to_srgb(light.float().clamp(0.0, 1.0)).permute(2, 0, 1)[None] for light in (image, truth)]
    # The window reaches beyond the border by reflection, which needs as many pixels; smaller images are repeated at their borders.
    pad = [max(0, SSIM_WINDOW - size) for size in (image.shape[1], image.shape[0])]
    shown = [torch.nn.functional.pad(light, (0, pad[0], 0, pad[1]), mode="replicate") for light in shown]
    return float(1.0 - ssim(shown[0], shown[1], SSIM_WINDOW).double().mean())
