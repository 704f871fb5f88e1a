"""Where the sky is: the skyline by dynamic programming, and what stands before the sky by a graph cut.

Nothing here knows clouds from clear sky; see `cloudfit.clear_sky`.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from cloudfit.outline import refine_outline

# Longest side at which sky and landscape are told apart [pixel]; the outline is refined at full size afterwards.
WORKING_SIDE = 320

# Fineness of the texture of one step of the picture, below which it is sensor noise and compression [1, display value].
TEXTURE_FLOOR = 2e-3

# Blue light is what landscape lacks most (vegetation, soil and rock absorb it, sky and cloud do not). A skyline is worth
# one unit where the logarithm of blue falls by this much from above to below, and half a unit where texture grows e-fold.
BLUE_FALL_UNIT = 0.5
BLUE_FLOOR = 0.03
TEXTURE_RISE_WEIGHT = 0.5

# Rows above and below a candidate skyline that are compared; about a hundredth of the working size to either side.
COMPARED_ROWS = 4

# Price of one row of climb of the skyline between neighbouring columns: a step of seven rows costs one unit of edge.
CLIMB_PRICE = 0.15

# Mean log texture above which a patch is no sky: leaves, masonry, rock. Cumulus rims stay below it.
LANDSCAPE_TEXTURE = -2.9
CLOUD_TEXTURE = -3.2
TEXTURE_PATCH_SIGMA = 4.0

# Price of each row of rough texture that a skyline leaves above itself, so that it runs over a cliff rather than along the
# snow below it: twenty such rows cost as much as one unit of edge.
ROUGH_ROW_PRICE = 0.05

# A skyline counts if its mean worth, less its mean price, less the share of what lies below it that looks like something
# above it, reaches this. (Measured: skylines 0.39 to 1.34; paths forced through pictures of sky alone 0.22 and less.)
LEAST_SKYLINE_WORTH = 0.3

# Everything farther below the skyline than this share of the height is certain landscape for the graph cut, and what is
# no rougher than clouds and rises that far above it is certain sky: dark clouds at sunset resemble the land.
CERTAIN_DEPTH = 0.08
CERTAIN_RISE = 0.03
GRAPH_CUT_ITERATIONS = 4
LEAST_LANDSCAPE = 0.005


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
    return refine_outline(display, sky)


def _reduce(display: np.ndarray) -> _Scene:
    """Working size; texture is measured at full size, before the reduction blurs it."""
    height, width = display.shape[:2]
    scale = min(1.0, WORKING_SIDE / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    curvature = np.abs(cv2.Laplacian(display.mean(axis=2), cv2.CV_32F, ksize=1))
    colours = cv2.resize(display, size, interpolation=cv2.INTER_AREA)
    texture = cv2.blur(cv2.resize(curvature, size, interpolation=cv2.INTER_AREA), (5, 5))
    return _Scene(colours, np.log(texture + TEXTURE_FLOOR), np.log(colours[..., 2] + BLUE_FLOOR))


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
    gain = worth[path, np.arange(width)].mean() - CLIMB_PRICE * np.abs(np.diff(path)).sum() / width
    above = np.arange(height)[:, None] < path
    if above.all() or not above.any() or gain - _known_below(scene, above) < LEAST_SKYLINE_WORTH:
        return None
    return path


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
LEAST_CELL_SHARE = 5e-4


def _known_below(scene: _Scene, above: np.ndarray) -> float:
    """Share of the pixels below the skyline whose colour and texture also occur above it."""
    lab = cv2.cvtColor(scene.colours, cv2.COLOR_RGB2LAB)
    cells = np.stack(
        [
            np.clip(lab[..., 0] / LIGHTNESS_CELL, 0, 7),
            np.clip(lab[..., 1] / COLOUR_CELL + 8, 0, 15),
            np.clip(lab[..., 2] / COLOUR_CELL + 8, 0, 15),
            np.clip((scene.texture - np.log(TEXTURE_FLOOR)) / TEXTURE_CELL, 0, 4),
        ]
    ).astype(np.int64)
    shape = (8, 16, 16, 5)
    index = np.ravel_multi_index(tuple(cells), shape)
    counts_above = np.bincount(index[above], minlength=int(np.prod(shape)))
    counts_below = np.bincount(index[~above], minlength=int(np.prod(shape)))
    return float(counts_below[counts_above > LEAST_CELL_SHARE * above.sum()].sum() / counts_below.sum())


def _cut(scene: _Scene, skyline: np.ndarray | None) -> np.ndarray:
    """Sky (height, width) by GrabCut in lightness, yellow-blue and texture, started from the skyline and from texture."""
    height, width = scene.blue.shape
    start = np.full((height, width), cv2.GC_PR_FGD, np.uint8)
    if skyline is not None:
        depth = np.arange(height)[:, None] - skyline
        start[depth >= 0] = cv2.GC_PR_BGD
        start[depth > CERTAIN_DEPTH * height] = cv2.GC_BGD
    patches = cv2.GaussianBlur(scene.texture, (0, 0), TEXTURE_PATCH_SIGMA)
    if skyline is not None:
        start[(depth < -CERTAIN_RISE * height) & (patches < CLOUD_TEXTURE)] = cv2.GC_FGD
    start[_standing(patches > LANDSCAPE_TEXTURE, start)] = cv2.GC_BGD
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


def _standing(rough: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Rough patches that stand on the landscape or on the picture's lower edge; those that float are clouds."""
    ground = (start == cv2.GC_PR_BGD) | (start == cv2.GC_BGD)
    _, patches = cv2.connectedComponents((rough | ground).astype(np.uint8))
    standing = np.unique(np.concatenate([patches[-1], patches[ground]]))
    return rough & np.isin(patches, standing[standing > 0])


def _hanging_from_top(sky: np.ndarray) -> np.ndarray:
    """Parts of the sky that reach the upper edge; snow, lakes and windows do not."""
    _, parts = cv2.connectedComponents(sky.astype(np.uint8), connectivity=4)
    hanging = np.unique(parts[0])
    return sky & np.isin(parts, hanging[hanging > 0])
