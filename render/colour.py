"""Colour of images: the piecewise sRGB curve, luminance, and the display curves that a histogram may be taken after."""

from collections.abc import Callable

from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb
from torch import Tensor

# Luminance of the Rec. 709 primaries under D65, which sRGB shares (ITU-R BT.709-6, item 3.2).
REC_709_LUMINANCE = (0.2126, 0.7152, 0.0722)


def _elementwise(curve: Callable[[Tensor], Tensor], values: Tensor) -> Tensor:
    """Apply a curve that wants (channel, height, width) to values of any shape whose last dimension is the channel."""
    if values.shape[-1:] != (3,):
        raise ValueError(f"expected colours of shape (..., 3), got {tuple(values.shape)}")
    return curve(values.reshape(3, -1, 1)).reshape(values.shape)


def srgb_to_linear(encoded: Tensor) -> Tensor:
    """Decode sRGB values to linear light.

    x / 12.92 up to 0.04045, ((x + 0.055) / 1.055)^2.4 above (IEC 61966-2-1); values above 1 continue the curve.

    Args:
        encoded: (..., channel) sRGB values [1], display white is 1.

    Returns:
        (..., channel) linear light [1].
    """
    return _elementwise(rgb_to_linear_rgb, encoded)


def linear_to_srgb(linear: Tensor) -> Tensor:
    """Encode linear light as sRGB values; the inverse of `srgb_to_linear`, not clipped.

    Args:
        linear: (..., channel) linear light [1], display white is 1.

    Returns:
        (..., channel) sRGB values [1].
    """
    return _elementwise(linear_rgb_to_rgb, linear)


def luminance(linear: Tensor) -> Tensor:
    """Relative luminance Y = 0.2126 R + 0.7152 G + 0.0722 B of linear light.

    Args:
        linear: (..., channel) linear light [1].

    Returns:
        (...) luminance [1].
    """
    return linear @ linear.new_tensor(REC_709_LUMINANCE)


def _no_curve(linear: Tensor) -> Tensor:
    """Leave linear light as it is: the raw intensities that the 2012 paper compares."""
    return linear


DISPLAY_CURVES: dict[str, Callable[[Tensor], Tensor]] = {"srgb": linear_to_srgb, "none": _no_curve}
