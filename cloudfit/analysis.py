"""What a photograph tells the fit: where its clouds are, the sky behind them, and the light that falls on them."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cloudfit.cloud_mask import CloudMask, Label, apply_user_mask, detect_clouds
from cloudfit.photograph import Photograph
from cloudfit.sky_fill import default_growth, fill_sky
from cloudfit.sunlight import Sunlight, estimate_sunlight
from render.errors import PhotographError

# Less cloud than this share of sky and cloud together is what dust, smoke and lamps before a clear sky amount to when they
# are mistaken for cloud (up to 0.05 measured). Clouds that the user has marked need no such margin.
MINIMUM_CLOUD_FRACTION = 0.06


class NoCloudError(PhotographError):
    """The photograph shows no cloud that could be fitted."""


@dataclass(frozen=True)
class PhotographAnalysis:
    """A photograph with everything the fit needs from it.

    Attributes:
        photograph: the photograph.
        mask: cloud, clear sky, and the rest.
        sky: (height, width, channel) linear light of the sky behind the clouds [1].
        sunlight: colour of the light on the clouds.
        warnings: sentences for the user.
    """

    photograph: Photograph
    mask: CloudMask
    sky: Tensor
    sunlight: Sunlight
    warnings: tuple[str, ...]


def analyse_photograph(photograph: Photograph, user_labels: Tensor | None = None) -> PhotographAnalysis:
    """Find clouds, sky and sunlight of a photograph.

    Args:
        photograph: the photograph.
        user_labels: (height, width) uint8 labels from `read_user_mask`, which win over the automatic ones.

    Returns:
        The analysis.

    Raises:
        NoCloudError: there is less cloud than `MINIMUM_CLOUD_FRACTION` of the sky.
    """
    mask = _label(photograph, user_labels)
    marked = user_labels is not None and bool((user_labels == Label.CLOUD).any())
    if not mask.cloud.any() or (mask.cloud_fraction < MINIMUM_CLOUD_FRACTION and not marked):
        raise NoCloudError(
            f"{photograph.path}: expected clouds, found {mask.cloud_fraction:.1%} of the sky covered "
            f"(at least {MINIMUM_CLOUD_FRACTION:.0%} is needed); mark them in a mask and pass it with --mask"
        )
    warnings = list(mask.warnings)
    if not mask.sky.any():
        warnings.append(
            f"{photograph.path.name} shows no clear sky; the sky behind the clouds is a guess from their brightness."
        )
    return PhotographAnalysis(
        photograph=photograph,
        mask=mask,
        sky=fill_sky(photograph.pixels, mask, default_growth(*photograph.pixels.shape[:2])),
        sunlight=estimate_sunlight(photograph.pixels, mask),
        warnings=tuple(warnings),
    )


def _label(photograph: Photograph, user_labels: Tensor | None) -> CloudMask:
    """Automatic labels, corrected by the user's, with OTHER where the photograph is transparent."""
    mask = detect_clouds(photograph.pixels)
    if user_labels is not None:
        mask = apply_user_mask(mask, user_labels)
    other = torch.full_like(mask.labels, Label.OTHER)
    return replace(mask, labels=torch.where(photograph.opaque, mask.labels, other))
