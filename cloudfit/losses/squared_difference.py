"""Pixelwise squared difference: images are compared pixel by pixel, in their places."""

from torch import Tensor

from cloudfit.losses.kinds import PhotographValues, PixelLoss


def squared_difference(values: Tensor, target: Tensor) -> Tensor:
    """Mean over the pixels of the squared difference, the "pixelwise" comparison of Dobashi et al. 2012, section 5.

    sum_q (v_q - v'_q)^2 / n. The photograph's clouds stand elsewhere than the volume's, so this is no measure of how alike two
    clouds look; it serves comparisons, and photographs that were rendered from the same view.

    Args:
        values: display values 0..1 (..., channel, pixel).
        target: the photograph's, at the same pixels (channel, pixel).

    Returns:
        (..., channel) in 0..1, float64 [1].
    """
    return (values - target.to(values)).square().double().mean(dim=-1)


def _in_place(photograph: PhotographValues) -> Tensor:
    return photograph.in_place


SQUARED_DIFFERENCE = PixelLoss("squared_difference", 0.0, 1.0, "1", "pixel", True, _in_place, squared_difference)
