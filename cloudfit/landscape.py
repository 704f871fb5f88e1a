"""Where the sky is: the skyline by dynamic programming, and what stands before the sky by a graph cut.

Nothing here knows clouds from clear sky; see `cloudfit.clear_sky`.
"""

from dataclasses import dataclass

import cv2
import numpy as np

# Longest side at which sky and landscape are told apart [pixel]; the outline is refined at full size afterwards.
WORKING_SIDE = 320

# Texture is the mean curvature from pixel to pixel [display value] at this longest side at most, less what the smoothest
# twentieth of the picture shows (sensor noise, compression), for a mean grey of one half: shaded masonry is as rough as lit.
TEXTURE_SIDE = 1024
NOISE_QUANTILE = 0.05
SHADE_FLOOR = 0.3
TEXTURE_FLOOR = 2e-3
TEXTURE_WINDOW = (5, 5)

# Blue light is what landscape lacks most (vegetation, soil and rock absorb it, sky and cloud do not). A skyline is worth
# one unit where the logarithm of blue falls by this much from above to below, and half a unit where texture grows e-fold.
BLUE_FALL_UNIT = 0.5
BLUE_FLOOR = 0.03
TEXTURE_RISE_WEIGHT = 0.5

# Rows above and below a candidate skyline that are compared; about a hundredth of the working size to either side.
COMPARED_ROWS = 4

# Price of one row of climb of the skyline between neighbouring columns: a step of seven rows costs one unit of edge.
CLIMB_PRICE = 0.15

# Mean log texture of a patch: clouds hardly reach the first; above the second it may stand before the sky where it rises
# from the ground (leaves, masonry, rock); above the third even silhouetted clouds at sunset do not come.
CLOUD_TEXTURE = -3.2
LANDSCAPE_TEXTURE = -3.0
MASONRY_TEXTURE = -2.8
TEXTURE_PATCH_SIGMA = 4.0

# Price of each row of rough texture that a skyline leaves above itself, so that it runs over a cliff rather than along the
# snow below it: twenty such rows cost as much as one unit of edge.
ROUGH_ROW_PRICE = 0.05

# A skyline counts if its mean worth, less `CLIMB_WEIGHT` times its climb per column, less `LIKENESS_WEIGHT` times the
# likeness of what lies on its two sides, reaches this. Skylines measure 0.8 to 1.3, a sea horizon in rain 0.4 to 0.5, paths
# forced through pictures of sky alone 0.1 and less, but for a dark horizontal bank of cloud 0.2 to 0.4.
LEAST_SKYLINE_WORTH = 0.25
CLIMB_WEIGHT = 0.3
LIKENESS_WEIGHT = 2.0

# Everything farther below the skyline than this share of the height is certain landscape for the graph cut, and what is
# that far above it and no masonry is certain sky: dark clouds at sunset resemble the land.
CERTAIN_DISTANCE = 0.08
GRAPH_CUT_ITERATIONS = 4

# Smaller certain landscape than this share of the picture teaches the graph cut nothing.
LEAST_LANDSCAPE = 0.005

# Guided filter that draws the outline along the edges of the full-size picture: its radius as a share of the longest side,
# and the variance of display values that counts as an edge.
OUTLINE_RADIUS = 0.008
OUTLINE_VARIANCE = 1e-4

# The sky ends this share of the longest side before the landscape: pixels there are a mixture of both.
SKY_MARGIN = 0.005


@dataclass(frozen=True)
class _Scene:
    """A photograph at working size: display colours (height, width, 3), log texture and log blue (height, width)."""

    colours: np.ndarray
    texture: np.ndarray
    blue: np.ndarray


def find_sky(display: np.ndarray) -> np.ndarray:
    """Sky, clear or cloudy, as opposed to land, water and buildings.

    Args:
        display: (height, width, channel) sRGB values 0..1, float32.

    Returns:
        (height, width) bool.
    """
    scene = _reduce(display)
    sky = _hanging_from_top(_cut(scene, _skyline(scene)))
    if sky.all():
        return np.ones(display.shape[:2], bool)
    return _refine_outline(display, sky)


def _reduce(display: np.ndarray) -> _Scene:
    """Working size; texture is measured before the reduction blurs it."""
    fine = _shrink(display, TEXTURE_SIDE)
    curvature = np.abs(cv2.Laplacian(fine.mean(axis=2), cv2.CV_32F, ksize=1))
    colours = _shrink(fine, WORKING_SIDE)
    texture = cv2.blur(_shrink(curvature, WORKING_SIDE), TEXTURE_WINDOW)
    texture = np.maximum(texture - np.quantile(texture, NOISE_QUANTILE), 0.0)
    grey = cv2.blur(colours.mean(axis=2), TEXTURE_WINDOW)
    texture *= (0.5 + SHADE_FLOOR) / (grey + SHADE_FLOOR)
    return _Scene(colours, np.log(texture + TEXTURE_FLOOR), np.log(colours[..., 2] + BLUE_FLOOR))


def _shrink(values: np.ndarray, side: int) -> np.ndarray:
    """Reduce the longest side to `side` at most."""
    height, width = values.shape[:2]
    scale = min(1.0, side / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return cv2.resize(values, size, interpolation=cv2.INTER_AREA)


def _means_beside(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of the rows above and below each of the height + 1 lines between rows; both 0 at the picture's edge."""
    height, width = values.shape
    sums = np.concatenate([np.zeros((1, width)), np.cumsum(values, axis=0, dtype=np.float64)])
    line = np.arange(height + 1)
    first, last = np.maximum(line - COMPARED_ROWS, 0), np.minimum(line + COMPARED_ROWS, height)
    above = (sums[line] - sums[first]) / np.maximum(line - first, 1)[:, None]
    below = (sums[last] - sums[line]) / np.maximum(last - line, 1)[:, None]
    return above, below


def _skyline(scene: _Scene) -> np.ndarray | None:
    """Row (width,) at which landscape begins in each column, or None where the picture shows no convincing one."""
    height, width = scene.blue.shape
    blue_above, blue_below = _means_beside(scene.blue)
    texture_above, texture_below = _means_beside(scene.texture)
    worth = np.clip((blue_above - blue_below) / BLUE_FALL_UNIT, -1.0, 1.0)
    worth += TEXTURE_RISE_WEIGHT * np.clip(texture_below - texture_above, -1.0, 1.0)
    worth[[0, -1]] = 0.0
    rough_above = np.cumsum(np.clip(scene.texture - CLOUD_TEXTURE, 0.0, 1.0), axis=0)
    path = _best_path(worth - ROUGH_ROW_PRICE * np.concatenate([np.zeros((1, width)), rough_above]))
    above = np.arange(height)[:, None] < path
    if above.all() or not above.any():
        return None
    gain = worth[path, np.arange(width)].mean() - CLIMB_WEIGHT * np.abs(np.diff(path)).sum() / width
    return path if gain - LIKENESS_WEIGHT * _likeness(scene, above) > LEAST_SKYLINE_WORTH else None


def _best_path(worth: np.ndarray) -> np.ndarray:
    """Row per column that maximises sum worth[row(x), x] - CLIMB_PRICE |row(x+1) - row(x)|, by the Viterbi recursion."""
    lines, width = worth.shape
    slope = CLIMB_PRICE * np.arange(lines)
    best = [worth[:, 0]]
    for column in range(1, width):
        # max over r' of best[r'] - price |r - r'|, in two running maxima instead of all pairs.
        from_above = np.maximum.accumulate(best[-1] + slope) - slope
        from_below = np.maximum.accumulate((best[-1] - slope)[::-1])[::-1] + slope
        best.append(np.maximum(from_above, from_below) + worth[:, column])
    path = np.empty(width, np.int64)
    path[-1] = int(np.argmax(best[-1]))
    for column in range(width - 2, -1, -1):
        path[column] = int(np.argmax(best[column] - np.abs(slope - slope[path[column + 1]])))
    return path


# Cells of the histogram in CIE Lab and log texture by which the two sides of a skyline are compared.
LIGHTNESS_CELL, COLOUR_CELL, TEXTURE_CELL = 12.5, 8.0, 1.0


def _likeness(scene: _Scene, above: np.ndarray) -> float:
    """Overlap of the histograms of colour and texture above and below a skyline: 0 for strangers, 1 for equals."""
    lab = cv2.cvtColor(scene.colours, cv2.COLOR_RGB2LAB)
    shape = (8, 16, 16, 5)
    cells = (
        lab[..., 0] / LIGHTNESS_CELL,
        lab[..., 1] / COLOUR_CELL + 8,
        lab[..., 2] / COLOUR_CELL + 8,
        (scene.texture - np.log(TEXTURE_FLOOR)) / TEXTURE_CELL,
    )
    clipped = tuple(np.clip(cell, 0, count - 1).astype(np.int64) for cell, count in zip(cells, shape, strict=True))
    index = np.ravel_multi_index(clipped, shape)
    count = int(np.prod(shape))
    shares = [np.bincount(index[side], minlength=count) / side.sum() for side in (above, ~above)]
    return float(np.minimum(*shares).sum())


def _cut(scene: _Scene, skyline: np.ndarray | None) -> np.ndarray:
    """Sky (height, width) by GrabCut in lightness, yellow-blue and texture, started from the skyline and from texture."""
    height, width = scene.blue.shape
    start = np.full((height, width), cv2.GC_PR_FGD, np.uint8)
    patches = cv2.GaussianBlur(scene.texture, (0, 0), TEXTURE_PATCH_SIGMA)
    if skyline is None:
        start[_standing(patches > LANDSCAPE_TEXTURE)] = cv2.GC_BGD
    else:
        depth = np.arange(height)[:, None] - skyline
        start[depth >= 0] = cv2.GC_PR_BGD
        start[depth > CERTAIN_DISTANCE * height] = cv2.GC_BGD
        start[(depth < -CERTAIN_DISTANCE * height) & (patches < MASONRY_TEXTURE)] = cv2.GC_FGD
    certain = start == cv2.GC_BGD
    if certain.mean() < LEAST_LANDSCAPE or (start & 1).mean() < LEAST_LANDSCAPE:
        return (start & 1).astype(bool)
    lab = cv2.cvtColor(scene.colours, cv2.COLOR_RGB2LAB)
    texture = (scene.texture - np.log(TEXTURE_FLOOR)) * 51.0
    features = np.stack([lab[..., 0] * 2.5, lab[..., 2] * 2.0 + 128.0, texture], axis=-1).clip(0, 255).astype(np.uint8)
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cut, _, _ = cv2.grabCut(features, start, None, *models, GRAPH_CUT_ITERATIONS, cv2.GC_INIT_WITH_MASK)
    return (cut & 1).astype(bool)


def _standing(rough: np.ndarray) -> np.ndarray:
    """Rough patches that stand on the picture's lower edge; those that float are clouds."""
    _, patches = cv2.connectedComponents(rough.astype(np.uint8))
    standing = np.unique(patches[-1])
    return rough & np.isin(patches, standing[standing > 0])


def _hanging_from_top(sky: np.ndarray) -> np.ndarray:
    """Parts of the sky that reach the upper edge; snow, lakes and windows do not."""
    _, parts = cv2.connectedComponents(sky.astype(np.uint8), connectivity=4)
    hanging = np.unique(parts[0])
    return sky & np.isin(parts, hanging[hanging > 0])


def _refine_outline(display: np.ndarray, sky: np.ndarray) -> np.ndarray:
    """Sky at full size: its outline drawn to the nearest edge, then drawn back by the margin."""
    height, width = display.shape[:2]
    coarse = cv2.resize(sky.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    radius = max(2, round(OUTLINE_RADIUS * max(height, width)))
    refined = (cv2.ximgproc.guidedFilter(display, coarse, radius, OUTLINE_VARIANCE) > 0.5).astype(np.uint8)
    margin = 2 * max(1, round(SKY_MARGIN * max(height, width))) + 1
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (margin, margin))
    return cv2.erode(refined, window, borderType=cv2.BORDER_CONSTANT, borderValue=1).astype(bool)
