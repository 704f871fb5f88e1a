"""Outlines found at a working size, redrawn along the edges of the full-size picture."""

import cv2
import numpy as np

# Radius of the guided filter as a share of the longest side, and the variance of display values that counts as an edge.
OUTLINE_RADIUS = 0.003
OUTLINE_VARIANCE = 1e-4


def refine_outline(display: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Enlarge a mask to the size of the picture, its outline drawn to the nearest edge by a guided filter.

    Args:
        display: (height, width, channel) sRGB values 0..1, float32.
        mask: bool, of any smaller or equal size.

    Returns:
        (height, width) bool.
    """
    height, width = display.shape[:2]
    coarse = cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    radius = max(2, round(OUTLINE_RADIUS * max(height, width)))
    return cv2.ximgproc.guidedFilter(display, coarse, radius, OUTLINE_VARIANCE) > 0.5
