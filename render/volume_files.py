"""Density volumes on disk: NumPy `.npz` and `.npy`, Mitsuba `.vol`, and `.vdb` where an OpenVDB module is installed.

Lengths in these files are metres. Every reader checks what the file promises against what it holds before it allocates,
and refuses with a `VolumeError` that names the file. Nothing is ever unpickled.
"""

import importlib
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import IO, Any, TypeVar

import numpy as np
import torch

from render.atomic_write import atomic_path
from render.density_grid import DensityGrid
from render.errors import VolumeError

LARGEST_VOXEL_COUNT = 1024**3
"""Volumes beyond this (4 GiB as float32) are refused: more likely a damaged or hostile file than a cloud."""

_Entry = TypeVar("_Entry")

_VOL_HEADER = struct.Struct("<3sB5i6f")
_VOL_VERSION = 3
_VOL_FLOAT32 = 1

# No deflate stream expands by more than this factor, so a zip member that claims more is lying about its size.
_LARGEST_DEFLATE_RATIO = 1032

# What the parsers of numpy, zipfile and zlib raise on foreign bytes.
_FOREIGN_BYTES = (
    ValueError,
    TypeError,
    KeyError,
    EOFError,
    SyntaxError,
    OverflowError,
    MemoryError,
    RuntimeError,
    struct.error,
    tokenize.TokenError,
    zlib.error,
    zipfile.BadZipFile,
)


def read_volume(path: str | Path) -> DensityGrid:
    """Density volume from a file, in the format that its suffix names.

    `.npz`: array `density` `(z, y, x)`; optionally `voxel_size_m`, one number or (x, y, z); optionally `lower_m`
    (x, y, z), the lowest corner. `.npy`: the array alone. Without a voxel size voxels are cubes of 1 m; without a
    corner the box is centred on the origin. `.vol`: Mitsuba's grid volume with one channel, its bounds taken as metres.
    `.vdb`: the float grid named `density`, else the first one, turned from y up to z up: (x, y, z) = (X, -Z, Y).

    Args:
        path: the file.

    Returns:
        The volume; lengths [m], density dimensionless.

    Raises:
        VolumeError: if the file is missing, empty, truncated, foreign or not a density; names the file and the reason.
    """
    path = Path(path)
    reader = _entry_for_suffix(_READERS, path, "read")
    try:
        if not path.is_file():
            raise VolumeError("there is no such file" if not path.exists() else "it is not a file")
        if path.stat().st_size == 0:
            raise VolumeError("the file is empty")
        return reader(path)
    except VolumeError as error:
        raise VolumeError(f"cannot read the volume {path}: {error}") from error
    except OSError as error:
        raise VolumeError(f"cannot read the volume {path}: {error.strerror or error}") from error
    except _FOREIGN_BYTES as error:
        detail = f"{type(error).__name__}: {str(error)[:200]!r}"  # a parser may quote the bytes it stumbled on
        raise VolumeError(f"cannot read the volume {path}: damaged, or not a {path.suffix} file ({detail})") from error


def write_volume(path: str | Path, grid: DensityGrid) -> None:
    """Write a volume that `read_volume` reads back; the file appears whole or not at all.

    Args:
        path: ends in `.npz` or `.vol`; the folder must exist.
        grid: the volume.

    Raises:
        VolumeError: for another suffix, or if the file cannot be written.
    """
    path = Path(path)
    writer = _entry_for_suffix(_WRITERS, path, "write")
    try:
        with atomic_path(path) as temporary:
            writer(temporary, grid)
    except OSError as error:
        raise VolumeError(f"cannot write the volume {path}: {error.strerror or error}") from error


def _entry_for_suffix(table: dict[str, _Entry], path: Path, verb: str) -> _Entry:
    entry = table.get(path.suffix.lower())
    if entry is None:
        formats = ", ".join(sorted(table))
        raise VolumeError(f"cannot {verb} the volume {path}: its name should end in one of {formats}")
    return entry


def _read_npz(path: Path) -> DensityGrid:
    with zipfile.ZipFile(path) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        if "density" not in members:
            held = ", ".join(sorted(members)) or "none"
            raise VolumeError(f"it needs an array named density; the arrays it holds: {held}")
        arrays = {
            name: _read_zip_member(archive, members[name])
            for name in ("density", "voxel_size_m", "lower_m")
            if name in members
        }
    voxel_size = _three_numbers(arrays.get("voxel_size_m", np.ones(1)), "voxel_size_m")
    if not (voxel_size > 0).all():
        raise VolumeError(f"voxel_size_m should be positive, not {voxel_size.tolist()}")
    lower = _three_numbers(arrays["lower_m"], "lower_m").tolist() if "lower_m" in arrays else None
    return DensityGrid.from_voxel_size(_as_density(arrays["density"]), voxel_size.tolist(), lower)


def _read_zip_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    largest = {
        zipfile.ZIP_STORED: info.compress_size,
        zipfile.ZIP_DEFLATED: info.compress_size * _LARGEST_DEFLATE_RATIO,
    }.get(info.compress_type)
    if largest is None:
        raise VolumeError(f"{info.filename} is compressed by a method that numpy.savez does not use")
    if info.file_size > largest:
        raise VolumeError(f"{info.filename} promises {info.file_size} bytes, more than its compressed data can hold")
    with archive.open(info) as stream:
        array = _read_npy_stream(stream, info.file_size, info.filename)
        if stream.read(1):
            raise VolumeError(f"{info.filename} holds more than its header promises")
    return array


def _read_npy(path: Path) -> DensityGrid:
    with path.open("rb") as stream:
        array = _read_npy_stream(stream, path.stat().st_size, "the array")
    return DensityGrid.from_voxel_size(_as_density(array), 1.0)


def _read_npy_stream(stream: IO[bytes], size: int, name: str) -> np.ndarray:
    """The array of a `.npy` stream of `size` bytes, after its header has been found to promise just that."""
    magic = stream.read(np.lib.format.MAGIC_LEN)
    if len(magic) < np.lib.format.MAGIC_LEN or not magic.startswith(np.lib.format.MAGIC_PREFIX):
        raise VolumeError(f"{name} does not start as a NumPy array")
    version = (magic[-2], magic[-1])
    if version not in _NPY_HEADER_READERS:
        raise VolumeError(f"{name} has the unknown NumPy format version {version[0]}.{version[1]}")
    shape, column_major, dtype = _NPY_HEADER_READERS[version](stream)
    if dtype.kind not in "fiub":
        raise VolumeError(f"{name} holds the type {dtype}; expected real numbers")
    count = math.prod(shape)
    if min(shape, default=0) < 0 or count > LARGEST_VOXEL_COUNT:
        raise VolumeError(f"{name} has the shape {shape}; at most {LARGEST_VOXEL_COUNT} numbers are read")
    promised, held = count * dtype.itemsize, size - stream.tell()
    if promised != held:
        raise VolumeError(f"{name} should hold {promised} bytes for the shape {shape}, but holds {held}: truncated?")
    data = stream.read(promised)
    if len(data) != promised:
        raise VolumeError(f"{name} ends after {len(data)} of {promised} bytes")
    return np.frombuffer(data, dtype=dtype).reshape(shape, order="F" if column_major else "C")


_NPY_HEADER_READERS: dict[tuple[int, int], Callable[[IO[bytes]], tuple[tuple[int, ...], bool, np.dtype]]] = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def _three_numbers(array: np.ndarray, name: str) -> np.ndarray:
    if array.size not in (1, 3) or not np.isfinite(array).all():
        raise VolumeError(f"{name} should be one number or three finite ones (x, y, z), not {array.tolist()}")
    return np.broadcast_to(array.astype(np.float64).reshape(-1), (3,))


def _as_density(array: np.ndarray) -> torch.Tensor:
    with np.errstate(over="ignore"):  # what exceeds float32 turns infinite, which DensityGrid refuses
        return torch.from_numpy(np.array(array, dtype=np.float32, order="C"))


def _read_vol(path: Path) -> DensityGrid:
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(_VOL_HEADER.size)
        if not head.startswith(b"VOL"):
            raise VolumeError("it does not start with the letters VOL of a Mitsuba grid volume")
        if len(head) < _VOL_HEADER.size:
            raise VolumeError(f"the header needs {_VOL_HEADER.size} bytes; the file ends after {size}")
        _, version, encoding, x, y, z, channels, *bounds = _VOL_HEADER.unpack(head)
        if version != _VOL_VERSION or encoding != _VOL_FLOAT32:
            raise VolumeError(f"expected version 3 and encoding 1 (float32), not {version} and {encoding}")
        if channels != 1:
            raise VolumeError(f"a density has one channel, not {channels}; write the density channel alone")
        if min(x, y, z) < 1 or x * y * z > LARGEST_VOXEL_COUNT:
            raise VolumeError(f"it has {x} x {y} x {z} voxels; expected 1 to {LARGEST_VOXEL_COUNT}")
        promised, held = 4 * x * y * z, size - _VOL_HEADER.size
        if promised != held:
            raise VolumeError(f"{x} x {y} x {z} voxels need {promised} bytes, but it holds {held}: truncated?")
        density = np.fromfile(stream, dtype="<f4", count=x * y * z).reshape(z, y, x)
    return DensityGrid(_as_density(density), torch.tensor(bounds[:3]), torch.tensor(bounds[3:]))


def _read_vdb(path: Path) -> DensityGrid:
    openvdb = _import_openvdb()
    try:
        grids = [grid for grid in openvdb.readAllGridMetadata(str(path)) if type(grid).__name__ == "FloatGrid"]
        if not grids:
            raise VolumeError("it holds no grid of float numbers")
        name = next((grid.name for grid in grids if grid.name == "density"), grids[0].name)
        grid = openvdb.read(str(path), name)
    except (OSError, RuntimeError) as error:
        raise VolumeError(f"OpenVDB refuses it: {error}") from error
    first, last = grid.evalActiveVoxelBoundingBox()
    shape = tuple(b - a + 1 for a, b in zip(first, last, strict=True))
    if min(shape) < 1:
        raise VolumeError(f"its grid {name!r} is empty")
    if math.prod(shape) > LARGEST_VOXEL_COUNT:
        raise VolumeError(f"its grid {name!r} spans {shape} voxels; at most {LARGEST_VOXEL_COUNT} are read")
    dense = np.zeros(shape, dtype=np.float32)
    grid.copyToArray(dense, ijk=first)
    corners = [grid.transform.indexToWorld(tuple(index)) for index in (np.subtract(first, 0.5), np.add(last, 0.5))]
    _check_axis_aligned(grid, corners, shape)
    (low_x, low_y, low_z), (high_x, high_y, high_z) = corners
    density = np.flip(dense.transpose(1, 2, 0), axis=1)  # (X, Y, Z) -> (z, y, x) = (Y, -Z, X)
    return DensityGrid(
        _as_density(density), torch.tensor([low_x, -high_z, low_y]), torch.tensor([high_x, -low_z, high_y])
    )


def _check_axis_aligned(grid: Any, corners: list[tuple[float, float, float]], shape: tuple[int, ...]) -> None:
    edges = np.subtract(corners[1], corners[0])
    expected = np.multiply(grid.transform.voxelSize(), shape)
    if not np.allclose(edges, expected, rtol=1e-4):
        raise VolumeError("its grid is rotated, mirrored or sheared; resample it along the axes first")


def _import_openvdb() -> ModuleType:
    for name in ("openvdb", "pyopenvdb"):
        try:
            return importlib.import_module(name)
        except ImportError:
            continue
    raise VolumeError(
        "reading .vdb needs the Python module openvdb, which is not installed here; install it with "
        "`conda install -c conda-forge openvdb`, or build it from the OpenVDB source with `pip install .`, "
        "or convert the file to .npz (array density (z, y, x), voxel_size_m) where OpenVDB is at hand"
    )


def _write_npz(path: Path, grid: DensityGrid) -> None:
    with path.open("wb") as stream:
        np.savez_compressed(
            stream,
            density=grid.density.cpu().numpy(),
            voxel_size_m=grid.voxel_size.cpu().numpy(),
            lower_m=grid.lower.cpu().numpy(),
        )


def _write_vol(path: Path, grid: DensityGrid) -> None:
    z, y, x = grid.density.shape
    bounds = (*grid.lower.tolist(), *grid.upper.tolist())
    with path.open("wb") as stream:
        stream.write(_VOL_HEADER.pack(b"VOL", _VOL_VERSION, _VOL_FLOAT32, x, y, z, 1, *bounds))
        stream.write(grid.density.cpu().numpy().astype("<f4").tobytes())


_READERS: dict[str, Callable[[Path], DensityGrid]] = {
    ".npz": _read_npz,
    ".npy": _read_npy,
    ".vol": _read_vol,
    ".vdb": _read_vdb,
}

_WRITERS: dict[str, Callable[[Path, DensityGrid], None]] = {".npz": _write_npz, ".vol": _write_vol}
