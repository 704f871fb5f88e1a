"""Depth maps in: one distance for every pixel, from OpenEXR or NumPy files."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import OpenEXR
import torch
from torch import Tensor

from render.errors import PhotographError

DEPTH_CHANNELS = ("Z", "depth.Z", "depth.Y", "depth.V", "distance.Y", "V", "Y", "R")
"""Channels of an EXR file that may hold the depth, the likeliest first; layers of a render end in these names too."""


def read_depth(path: Path | str) -> Tensor:
    """Read a depth map.

    Args:
        path: an `.exr` file with a channel such as Z, depth.Z, V, Y or R, or a `.npy` array (height, width) [m].

    Returns:
        (height, width) depth [m], float32; infinite where there is sky.

    Raises:
        PhotographError: the file is missing, truncated, of another kind or without a depth, or holds NaN or depths that are not positive.
    """
    path = Path(path)
    if path.suffix.lower() not in _READERS:
        raise PhotographError(f"{path}: expected a depth map that ends in {' or '.join(_READERS)}")
    if not path.is_file():
        raise PhotographError(f"{path}: no such file; check the name")
    depth = np.ascontiguousarray(_READERS[path.suffix.lower()](path), dtype=np.float32)
    if depth.ndim != 2 or depth.size == 0:
        raise PhotographError(f"{path}: expected one depth per pixel (height, width), got the shape {depth.shape}")
    bad = int((~(depth > 0.0)).sum())
    if bad:
        raise PhotographError(
            f"{path}: expected depths above 0 m (infinite for the sky), got {bad} that are not, or are NaN"
        )
    return torch.from_numpy(depth)


def _read_exr(path: Path) -> np.ndarray:
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.asarray(c.pixels) for name, c in file.parts[0].channels.items()}
    except Exception as error:  # OpenEXR raises RuntimeError, ValueError or TypeError, depending on where it stumbles
        raise PhotographError(f"{path}: no EXR file, or truncated or damaged ({error})") from error
    for wanted in DEPTH_CHANNELS:
        for name, pixels in channels.items():
            if name == wanted or name.endswith(f".{wanted}"):
                if wanted == "R" and not np.array_equal(pixels, channels.get("G", pixels)):
                    raise PhotographError(
                        f"{path}: expected a depth, got a coloured picture; save the depth as channel Z"
                    )
                return pixels
    raise PhotographError(
        f"{path}: expected a depth channel such as Z, depth.Z, V, Y or R, got {', '.join(sorted(channels))}"
    )


def _read_npy(path: Path) -> np.ndarray:
    try:
        array = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise PhotographError(f"{path}: no NumPy array, or truncated ({error})") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise PhotographError(f"{path}: expected an array of numbers")
    return array


_READERS: Mapping[str, Callable[[Path], np.ndarray]] = MappingProxyType({".exr": _read_exr, ".npy": _read_npy})
