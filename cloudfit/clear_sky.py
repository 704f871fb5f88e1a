"""Clouds among the sky: what is less blue than the clear sky around it or, against a low sun, darker than the glow.

Blueness is chroma with a sign, (B - R) / (B + R): the paper tells clouds from sky by chroma alone, which takes the glow of a
sunset for cloud and its dark clouds for sky. So the picture decides first what kind of sky it shows:

- by day the clear sky is the smooth upper envelope of the blueness, and clouds fall short of it;
- a sky that is nowhere blue is overcast, and so is a rough one in which the outline of such clouds runs along no edge;
- against a low sun the clear sky glows warm and varies smoothly along each row: clouds are the dark valleys in the rows.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

# Longest side at which clouds are told from clear sky [pixel]; the scores are interpolated to full size.
WORKING_SIDE = 512

# Display values below which neither a colour nor a logarithm means anything (sensor noise, compression).
DISPLAY_FLOOR = 0.03

# Smoothing against noise [pixel at working size].
NOISE_SIGMA = 1.2

# Structures between these sizes are what roughness measures [pixel at working size], and how far it is averaged.
FINE_SIGMA, COARSE_SIGMA, ROUGHNESS_SIGMA = 2.0, 8.0, 8.0
ROW_FINE_SIGMA, ROW_COARSE_SIGMA = 2.0, 10.0
ROUGHNESS_FLOOR = 1e-3


@dataclass(frozen=True)
class _SkyView:
    """The sky at working size.

    Attributes:
        sky: (height, width) bool.
        grey: mean display value, smoothed within the sky [1].
        blueness: (B - R) / (B + R + floor), smoothed within the sky [1].
    """

    sky: np.ndarray
    grey: np.ndarray
    blueness: np.ndarray

    def blur(self, values: np.ndarray, sigma_x: float, sigma_y: float | None = None) -> np.ndarray:
        """Gaussian mean over the sky pixels alone, so that the landscape does not bleed into the sky."""
        weight = self.sky.astype(np.float32)
        sigma_y = sigma_x if sigma_y is None else sigma_y
        total = cv2.GaussianBlur(values * weight, (0, 0), sigma_x, sigmaY=sigma_y)
        return total / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma_x, sigmaY=sigma_y), 1e-3)

    @cached_property
    def log_grey(self) -> np.ndarray:
        """Logarithm of the display grey, so that contrasts count alike in light and shade."""
        return np.log(self.grey + DISPLAY_FLOOR)

    @cached_property
    def roughness(self) -> np.ndarray:
        """Logarithm of the local contrast of structures of cloud size."""
        return _log_contrast(self, self.blur(self.log_grey, FINE_SIGMA) - self.blur(self.log_grey, COARSE_SIGMA))


def _log_contrast(view: _SkyView, detail: np.ndarray) -> np.ndarray:
    """Logarithm of the local root mean square of a detail image."""
    return np.log(np.sqrt(view.blur(detail**2, ROUGHNESS_SIGMA)) + ROUGHNESS_FLOOR)


def find_clouds(display: np.ndarray, in_sky: np.ndarray) -> np.ndarray:
    """Clouds among the sky pixels.

    Args:
        display: (height, width, channel) sRGB values 0..1, float32.
        in_sky: (height, width) bool, True where there is sky, clear or cloudy.

    Returns:
        (height, width) bool, False outside the sky.
    """
    # Near black there is no colour to judge by.
    in_sky = in_sky & (display.mean(axis=2) > DISPLAY_FLOOR)
    if not in_sky.any():
        return in_sky
    view = _view(display, in_sky)
    envelope = _blueness_envelope(view)
    score = _whiteness_score(view, envelope)
    glowing = _glow_share(view) > LEAST_GLOW
    overcast = _is_overcast(view, envelope, score > 1.0, glowing)
    if glowing:
        silhouettes = _silhouette_score(view)
        if not overcast or (silhouettes > 1.0).sum() > LEAST_SILHOUETTES * view.sky.sum():
            score, overcast = silhouettes, False
    if overcast:
        return in_sky
    height, width = in_sky.shape
    return in_sky & _without_specks(cv2.resize(score, (width, height), interpolation=cv2.INTER_LINEAR) > 1.0)


def _view(display: np.ndarray, in_sky: np.ndarray) -> _SkyView:
    height, width = in_sky.shape
    scale = min(1.0, WORKING_SIDE / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    colours = cv2.resize(display, size, interpolation=cv2.INTER_AREA)
    sky = cv2.resize(in_sky.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(bool)
    if not sky.any():
        # A few sky pixels that the reduction skipped.
        sky = np.ones_like(sky)
    raw = _SkyView(sky, colours.mean(axis=2), np.zeros_like(colours[..., 0]))
    red, blue = raw.blur(colours[..., 0], NOISE_SIGMA), raw.blur(colours[..., 2], NOISE_SIGMA)
    return _SkyView(sky, raw.blur(raw.grey, NOISE_SIGMA), (blue - red) / (blue + red + DISPLAY_FLOOR))


# Sky is warm below this blueness. Warm clouds at dusk are rough along the row; a glow is smoother than this log roughness.
WARM_BLUENESS = -0.08
GLOW_ROUGHNESS = -4.6

# Share of the sky that must glow before clouds are looked for as silhouettes; and the part of the sky above the horizon in
# which a tenth must: a glow stands on the horizon (there 0.4 of a sunset glows), a cloud in evening light floats above it.
LEAST_GLOW = 0.04
HORIZON_PART, LEAST_HORIZON_GLOW = 0.1, 0.1


def _glow_share(view: _SkyView) -> float:
    """Share of the sky that is warm and smooth along the row, if it stands on the horizon: the glow around a low sun."""
    row_detail = view.blur(view.log_grey, ROW_FINE_SIGMA, 0.5) - view.blur(view.log_grey, ROW_COARSE_SIGMA, 0.5)
    smooth = _log_contrast(view, row_detail) < GLOW_ROUGHNESS
    glow = view.sky & (view.blueness < WARM_BLUENESS) & smooth
    rows = np.arange(len(glow))[:, None]
    horizon = view.sky & (rows >= np.quantile(np.nonzero(view.sky)[0], 1.0 - HORIZON_PART))
    return float(glow.sum() / view.sky.sum()) if glow[horizon].mean() > LEAST_HORIZON_GLOW else 0.0


# Widest silhouette, as a share of the picture's width, and the log darkness at which a valley is a cloud.
WIDEST_SILHOUETTE = 0.4
SILHOUETTE_DEPTH = 0.15

# Share of the sky that must be silhouettes where the sky would otherwise count as overcast: clouds lit from below glow too.
LEAST_SILHOUETTES = 0.06


def _silhouette_score(view: _SkyView) -> np.ndarray:
    """Depth of the dark valleys in the rows, 1 at `SILHOUETTE_DEPTH`.

    A morphological closing along the row fills every valley narrower than its window and leaves whatever rises to one
    maximum and falls again, such as the glow around the sun, the falling off to the corners, or a slope.
    """
    half = max(1, round(WIDEST_SILHOUETTE * view.sky.shape[1] / 2))
    outside = float(np.log(DISPLAY_FLOOR)) - 1.0
    brightness = np.where(view.sky, view.log_grey, outside).astype(np.float32)
    # Room for the closing to reach beyond the picture: without it every slope at the edge would be a valley.
    padded = cv2.copyMakeBorder(brightness, 0, 0, half, half, cv2.BORDER_CONSTANT, value=outside)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, np.ones((1, 2 * half + 1), np.uint8))[:, half:-half]
    return np.where(view.sky, closed - brightness, 0.0).astype(np.float32) / SILHOUETTE_DEPTH


# The envelope is the expectile of this order: one pixel above it weighs as much as thirty below. Rough pixels, which are
# clouds or their rims, weigh a fifth of smooth ones.
ENVELOPE_ORDER = 0.97
ENVELOPE_ITERATIONS = 10
SMOOTH_ROUGHNESS = -4.2
ROUGH_WEIGHT = 0.2

# Ridge of the terms 1, x, y, x^2, y^2 of the envelope, against running away where there is only cloud.
ENVELOPE_RIDGE = np.array([0.0, 2e-4, 2e-4, 2e-3, 2e-3])

# A sky whose envelope stays below this blueness is overcast; a tenth of it may be bluer by extrapolation.
LEAST_BLUENESS = 0.07
OVERCAST_QUANTILE = 0.9

# Median slope of the blueness across the outline of real clouds [1/pixel at working size]: 5e-3 to 3e-2 where clear sky is
# seen, 2e-3 to 4e-3 where the outline merely divides a rain cloud; and the roughness above which such a sky is no clear one.
LEAST_CONTRAST = 4.5e-3
OVERCAST_ROUGHNESS = -5.3


def _blueness_envelope(view: _SkyView) -> np.ndarray:
    """Blueness that clear sky has, or would have, at each pixel: an upper expectile surface of low order."""
    height, width = view.sky.shape
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    terms = np.stack([np.ones_like(x), x, y, x * x, y * y], axis=-1)
    base = np.where(view.roughness < SMOOTH_ROUGHNESS, 1.0, ROUGH_WEIGHT)[view.sky]
    rows, values = terms[view.sky].astype(np.float64), view.blueness[view.sky].astype(np.float64)
    weight = base
    for _ in range(ENVELOPE_ITERATIONS):
        weighted = rows * (weight / weight.sum())[:, None]
        coefficients = np.linalg.solve(weighted.T @ rows + np.diag(ENVELOPE_RIDGE), weighted.T @ values)
        weight = base * np.where(values > rows @ coefficients, ENVELOPE_ORDER, 1.0 - ENVELOPE_ORDER)
    return np.minimum(terms @ coefficients, np.quantile(values, 0.99))


# Clouds fall short of the envelope by this share of it, and by this much at least (noise, haze).
WHITER_SHARE = 0.33
WHITER_LEAST = 0.03

# Clear sky far below white is saturated (Rayleigh); a grey that dark is a cloud in shade. Blueness asked for per darkness
# beyond a threshold, darkness being 1 - grey / white of the sky.
SHADE_SLOPE, SHADE_THRESHOLD = 0.5, 0.3


def _whiteness_score(view: _SkyView, envelope: np.ndarray) -> np.ndarray:
    """How far the blueness falls short of the envelope, or of what a clear sky so dark would have; clouds exceed 1."""
    white = max(float(np.quantile(view.grey[view.sky], 0.99)), DISPLAY_FLOOR)
    shortfall = (envelope - view.blueness) / np.maximum(WHITER_LEAST, WHITER_SHARE * envelope)
    shade = SHADE_SLOPE * (1.0 - view.grey / white - SHADE_THRESHOLD)
    shaded = 1.0 + (shade - view.blueness) / WHITER_LEAST
    return np.where(view.sky, np.maximum(shortfall, shaded), 0.0).astype(np.float32)


def _is_overcast(view: _SkyView, envelope: np.ndarray, cloud: np.ndarray, glowing: bool) -> bool:
    """Whether the sky shows no clear part: nowhere blue, or rough with no edge where blue would turn to white."""
    rough = float(np.median(view.roughness[view.sky])) > OVERCAST_ROUGHNESS
    if np.quantile(envelope[view.sky], OVERCAST_QUANTILE) < LEAST_BLUENESS:
        # A smooth sky that glows is a clear one at sunset, without a patch of blue in the frame.
        return rough or not glowing
    return rough and _outline_contrast(view, cloud) < LEAST_CONTRAST


def _outline_contrast(view: _SkyView, cloud: np.ndarray) -> float:
    """Median slope of the blueness along the outline of the clouds, away from the landscape; 0 without an outline."""
    window = np.ones((3, 3), np.uint8)
    values = cloud.astype(np.uint8)
    inside = cv2.erode(view.sky.astype(np.uint8), window, iterations=4, borderType=cv2.BORDER_CONSTANT, borderValue=1)
    outline = (cv2.dilate(values, window) != cv2.erode(values, window)) & inside.astype(bool)
    if not outline.any():
        return 0.0
    # The 3 x 3 Sobel kernel sums to 8 per unit of slope.
    slope = np.hypot(cv2.Sobel(view.blueness, cv2.CV_32F, 1, 0), cv2.Sobel(view.blueness, cv2.CV_32F, 0, 1)) / 8.0
    return float(np.median(slope[outline]))


# Clouds, and gaps in them, below this share of the picture are noise.
LEAST_SPECK = 1e-4


def _without_specks(cloud: np.ndarray) -> np.ndarray:
    """Remove specks of cloud, then specks of sky in clouds."""
    for _ in range(2):
        _, parts, statistics, _ = cv2.connectedComponentsWithStats(cloud.astype(np.uint8), connectivity=8)
        large = statistics[:, cv2.CC_STAT_AREA] >= LEAST_SPECK * cloud.size
        large[0] = False
        cloud = ~large[parts]
    return cloud
