"""Which pixels of a photograph are cloud, which are clear sky, and which are neither; found, given or corrected."""

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from cloudfit.clear_sky import find_clouds
from cloudfit.landscape import find_sky
from render.colour import linear_to_srgb
from render.errors import InputError
from render.image_files import read_mask_png

# Height over width of a mask may differ from the photograph's by this factor (and by one pixel) before it is refused
# as drawn for another picture.
ASPECT_TOLERANCE = 1.05


class Label(IntEnum):
    """Grey levels of a mask; also the format of mask files, in which NOT_CLOUD does not occur."""

    AUTOMATIC = 0
    NOT_CLOUD = 1
    OTHER = 85
    SKY = 170
    CLOUD = 255


FILE_LABELS = (Label.AUTOMATIC, Label.OTHER, Label.SKY, Label.CLOUD)


@dataclass(frozen=True)
class CloudMask:
    """Labels of a photograph.

    Attributes:
        labels: (height, width) uint8, each one of OTHER, SKY, CLOUD.
        source: "automatic", "user" (every pixel decided by the user's mask) or "corrected" (some of them).
        warnings: sentences for the user.
    """

    labels: Tensor
    source: str = "automatic"
    warnings: tuple[str, ...] = ()

    @property
    def cloud(self) -> Tensor:
        """(height, width) bool, True where there is cloud."""
        return self.labels == Label.CLOUD

    @property
    def sky(self) -> Tensor:
        """(height, width) bool, True where there is clear sky."""
        return self.labels == Label.SKY

    @property
    def other(self) -> Tensor:
        """(height, width) bool, True where there is neither: land, water, buildings."""
        return self.labels == Label.OTHER

    @property
    def cloud_fraction(self) -> float:
        """Cloud pixels per cloud and sky pixels [1]; 0 where there is neither."""
        cloud, sky = int(self.cloud.sum()), int(self.sky.sum())
        return cloud / (cloud + sky) if cloud else 0.0


def detect_clouds(pixels: Tensor) -> CloudMask:
    """Label cloud, clear sky and landscape of a photograph.

    Args:
        pixels: (height, width, channel) linear light [1], display white is 1.

    Returns:
        The mask.
    """
    display = np.ascontiguousarray(linear_to_srgb(pixels.detach().cpu().clamp(0.0, 1.0)).numpy())
    in_sky = find_sky(display)
    cloud = find_clouds(display, in_sky)
    labels = np.where(cloud, Label.CLOUD, np.where(in_sky, Label.SKY, Label.OTHER)).astype(np.uint8)
    return CloudMask(torch.from_numpy(labels))


def read_user_mask(path: Path | str, size: tuple[int, int]) -> Tensor:
    """Read a mask drawn by the user, brought to the photograph's size by nearest neighbour.

    A file that holds only 0 and 255 is a plain cloud mask: 255 is CLOUD and 0 is NOT_CLOUD. Otherwise its grey levels are
    0 AUTOMATIC, 85 OTHER, 170 SKY, 255 CLOUD.

    Args:
        path: a grey 8-bit image.
        size: (height, width) of the photograph [pixel].

    Returns:
        (height, width) uint8 labels.

    Raises:
        InputError: the file cannot be read, has another shape than the photograph, or holds other grey levels.
    """
    stored = read_mask_png(path)
    height, width = size
    # Side by side in cross products, with a pixel of slack for the rounding of a reduced size.
    products = stored.shape[0] * width, stored.shape[1] * height
    if max(products) > ASPECT_TOLERANCE * min(products) + max(*stored.shape, height, width):
        raise InputError(
            f"{path}: expected a mask in the shape of the photograph ({width} x {height} pixels), "
            f"got {stored.shape[1]} x {stored.shape[0]}; draw it on the photograph itself"
        )
    levels = set(np.unique(stored).tolist())
    wrong = sorted(levels - set(FILE_LABELS))
    if wrong:
        shown = ", ".join(map(str, wrong[:5])) + (", ..." if len(wrong) > 5 else "")
        raise InputError(
            f"{path}: expected the grey levels 0 (automatic), 85 (other), 170 (sky) and 255 (cloud), got {shown}; "
            "save the mask without anti-aliasing, as PNG"
        )
    labels = cv2.resize(stored, (width, height), interpolation=cv2.INTER_NEAREST)
    if levels <= {Label.AUTOMATIC, Label.CLOUD}:
        labels = np.where(labels == Label.CLOUD, labels, np.uint8(Label.NOT_CLOUD))
    return torch.from_numpy(labels)


def apply_user_mask(mask: CloudMask, user_labels: Tensor) -> CloudMask:
    """Let the user's labels win over the automatic ones.

    AUTOMATIC keeps the label found; NOT_CLOUD keeps it too, but turns a cloud into sky (a cloud is found only in the sky).

    Args:
        mask: labels found.
        user_labels: (height, width) uint8 from `read_user_mask`.

    Returns:
        The mask, "user" where every pixel was decided by the user, else "corrected".

    Raises:
        ValueError: the two have different sizes.
    """
    if user_labels.shape != mask.labels.shape:
        raise ValueError(f"expected labels of shape {tuple(mask.labels.shape)}, got {tuple(user_labels.shape)}")
    found = mask.labels
    not_cloud = torch.where(mask.cloud, torch.full_like(found, Label.SKY), found)
    labels = torch.where(user_labels == Label.AUTOMATIC, found, user_labels.to(found.dtype))
    labels = torch.where(user_labels == Label.NOT_CLOUD, not_cloud, labels)
    automatic = bool((user_labels == Label.AUTOMATIC).any())
    return CloudMask(labels, "corrected" if automatic else "user", mask.warnings)
