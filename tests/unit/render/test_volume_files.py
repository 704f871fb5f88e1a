"""Volume files: what is written is read back, and bytes that are no density end in a VolumeError."""

import io
import struct
import sys
import types
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from render.density_grid import DensityGrid
from render.errors import VolumeError
from render.volume_files import LARGEST_VOXEL_COUNT, read_volume, write_volume
from tests.support.shared_data import shared_file

FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def grid() -> DensityGrid:
    density = torch.rand(3, 4, 5, generator=torch.Generator().manual_seed(1))
    return DensityGrid(density, torch.tensor([-1.0, 2.0, 100.0]), torch.tensor([4.0, 10.0, 103.0]))


def vol_bytes(
    voxels: Sequence[int] = (2, 1, 1),
    channels: int = 1,
    values: Sequence[float] = (0.25, 0.5),
    bounds: Sequence[float] = (0, 0, 0, 2, 1, 1),
    version: int = 3,
    encoding: int = 1,
) -> bytes:
    head = struct.pack("<3sB5i6f", b"VOL", version, encoding, *voxels, channels, *bounds)
    return head + np.array(values, "<f4").tobytes()


def npy_bytes(shape: tuple[int, ...], data: bytes, descr: str = "<f4") -> bytes:
    """An array file whose header promises `shape`, whatever `data` holds."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": descr, "fortran_order": False, "shape": shape})
    return stream.getvalue() + data


def npz_bytes(method: int = zipfile.ZIP_DEFLATED, **members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return stream.getvalue()


def as_npy(values: object) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.asarray(values))
    return stream.getvalue()


def written(tmp_path: Path, name: str, data: bytes) -> Path:
    path = tmp_path / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("suffix", [".npz", ".vol", ".NPZ"])
def test_a_written_volume_is_read_back_exactly(tmp_path: Path, grid: DensityGrid, suffix: str) -> None:
    path = tmp_path / f"cloud{suffix}"
    write_volume(path, grid)
    again = read_volume(path)
    assert torch.equal(again.density, grid.density)
    assert not torch.equal(again.density.flip(0), grid.density)
    torch.testing.assert_close(again.lower, grid.lower)
    torch.testing.assert_close(again.upper, grid.upper)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_vol_values_run_along_x_first(tmp_path: Path) -> None:
    values = np.arange(24.0)
    grid = read_volume(written(tmp_path, "c.vol", vol_bytes((4, 3, 2), 1, values, (0, 0, 0, 4, 3, 2))))
    assert grid.density.shape == (2, 3, 4)
    assert float(grid.density[0, 0, 1]) == 1.0
    assert float(grid.density[0, 1, 0]) == 4.0
    assert float(grid.density[1, 0, 0]) == 12.0
    assert float(grid.look_up_density(torch.tensor([1.5, 0.5, 0.5]))) == 1.0


def test_npy_has_cubic_voxels_of_one_metre_around_the_origin(tmp_path: Path) -> None:
    grid = read_volume(written(tmp_path, "c.npy", as_npy(np.ones((2, 4, 6)))))
    assert grid.lower.tolist() == [-3.0, -2.0, -1.0]
    assert grid.upper.tolist() == [3.0, 2.0, 1.0]


def test_npz_takes_voxel_size_and_corner_in_x_y_z(tmp_path: Path) -> None:
    density = as_npy(np.ones((2, 4, 6)))
    data = npz_bytes(density=density, voxel_size_m=as_npy([1.0, 2.0, 3.0]), lower_m=as_npy([10.0, 20.0, 30.0]))
    grid = read_volume(written(tmp_path, "c.npz", data))
    assert grid.lower.tolist() == [10.0, 20.0, 30.0]
    assert grid.upper.tolist() == [16.0, 28.0, 36.0]
    scalar = read_volume(written(tmp_path, "s.npz", npz_bytes(density=density, voxel_size_m=as_npy(0.5))))
    assert scalar.upper.tolist() == [1.5, 1.0, 0.5]


@pytest.mark.parametrize("dtype", ["float64", "float16", "uint8", "int32", ">f4", "bool"])
def test_real_numbers_of_any_type_and_layout_are_read(tmp_path: Path, dtype: str) -> None:
    values = np.asfortranarray(np.arange(24).reshape(2, 3, 4) % 2).astype(dtype)
    expected = torch.from_numpy(values.astype(np.float32))
    assert torch.equal(read_volume(written(tmp_path, "c.npy", as_npy(values))).density, expected)


def test_the_largest_volume_of_the_shared_data_is_read() -> None:
    grid = read_volume(shared_file("volumes/wdas_cloud_sixteenth.npz"))
    assert grid.density.shape == (86, 154, 126)
    assert float(grid.density.max()) == 1.0
    torch.testing.assert_close(grid.voxel_size, torch.full((3,), 10.0 / 3.0))


BAD_FILES: dict[str, tuple[str, bytes, str]] = {
    "empty": ("c.npz", b"", "empty"),
    "foreign npz": ("c.npz", b"not a zip at all", "damaged"),
    "foreign npy": ("c.npy", b"P6 4 4 255 picture", "NumPy array"),
    "foreign vol": ("c.vol", b"P6 4 4 255 picture" * 10, "VOL"),
    "unknown suffix": ("c.raw", b"1234", r"\.npy, \.npz, \.vdb, \.vol"),
    "short vol header": ("c.vol", vol_bytes()[:20], "header needs 48 bytes"),
    "truncated vol": ("c.vol", vol_bytes()[:-1], "need 8 bytes, but it holds 7"),
    "overlong vol": ("c.vol", vol_bytes() + b"\0", "holds 9"),
    "vol of three channels": ("c.vol", vol_bytes((1, 1, 1), 3, (1, 2, 3)), "one channel, not 3"),
    "vol of version 4": ("c.vol", vol_bytes(version=4), "version 3"),
    "vol of bytes": ("c.vol", vol_bytes(encoding=3), "encoding 1"),
    "vol without voxels": ("c.vol", vol_bytes((0, 1, 1), values=()), "0 x 1 x 1"),
    "vol of negative size": ("c.vol", vol_bytes((-2, -1, 1)), "voxels"),
    "vol that promises the moon": ("c.vol", vol_bytes((2**30, 2**30, 2**30)), "voxels"),
    "vol without extent": ("c.vol", vol_bytes(bounds=(0, 0, 0, 2, 0, 1)), "extent"),
    "vol with a NaN bound": ("c.vol", vol_bytes(bounds=(0, 0, 0, np.nan, 1, 1)), "finite"),
    "NaN density": ("c.vol", vol_bytes(values=(np.nan, 1)), "NaN"),
    "infinite density": ("c.npy", as_npy(np.full((1, 1, 1), np.inf)), "infinite"),
    "beyond float32": ("c.npy", as_npy(np.full((1, 1, 1), 1e300)), "infinite"),
    "negative density": ("c.npy", as_npy(np.full((1, 1, 1), -1.0)), "negative"),
    "two dimensions": ("c.npy", as_npy(np.ones((4, 4))), r"\(z, y, x\)"),
    "no dimension": ("c.npy", as_npy(1.0), r"\(z, y, x\)|shape"),
    "zero size": ("c.npy", as_npy(np.ones((0, 4, 4))), "empty axes"),
    "complex numbers": ("c.npy", as_npy(np.ones((1, 1, 1), complex)), "real numbers"),
    "text": ("c.npy", as_npy(np.full((1, 1, 1), "a")), "real numbers"),
    "objects, which would be unpickled": ("c.npy", npy_bytes((1, 1, 1), b"cos\nsystem\n.", "|O"), "real numbers"),
    "npy of version 9": ("c.npy", b"\x93NUMPY\x09\x00" + as_npy(np.ones((1, 1, 1)))[8:], "version 9"),
    "truncated npy": ("c.npy", as_npy(np.ones((2, 2, 2)))[:-1], "truncated"),
    "npy that promises the moon": ("c.npy", npy_bytes((2**20, 2**20, 2**20), b"1234"), "at most"),
    "npy of negative size": ("c.npy", npy_bytes((-1, -1, 1), b"1234"), "at most"),
    "npz without density": ("c.npz", npz_bytes(smoke=as_npy(np.ones((1, 1, 1)))), "named density.*smoke"),
    "npz member that promises more": ("c.npz", npz_bytes(density=npy_bytes((64, 64, 64), b"1234")), "holds 4"),
    "npz voxel size of zero": (
        "c.npz",
        npz_bytes(density=as_npy(np.ones((1, 1, 1))), voxel_size_m=as_npy(0.0)),
        "posi",
    ),
    "npz voxel size of two": (
        "c.npz",
        npz_bytes(density=as_npy(np.ones((1, 1, 1))), voxel_size_m=as_npy([1, 2])),
        "x, y",
    ),
    "npz NaN corner": ("c.npz", npz_bytes(density=as_npy(np.ones((1, 1, 1))), lower_m=as_npy([np.nan] * 3)), "finite"),
    "npz by lzma": ("c.npz", npz_bytes(zipfile.ZIP_LZMA, density=as_npy(np.ones((1, 1, 1)))), "savez"),
    "truncated npz": ("c.npz", npz_bytes(density=as_npy(np.ones((8, 8, 8))))[:-30], "damaged"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_are_refused_with_name_and_reason(tmp_path: Path, case: str) -> None:
    name, data, reason = BAD_FILES[case]
    path = written(tmp_path, name, data)
    with pytest.raises(VolumeError, match=reason) as caught:
        read_volume(path)
    assert str(path) in str(caught.value)


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(VolumeError, match="no such file"):
        read_volume(tmp_path / "absent.npz")
    (tmp_path / "folder.vol").mkdir()
    with pytest.raises(VolumeError, match="not a file"):
        read_volume(tmp_path / "folder.vol")


def test_writing_where_no_folder_is_names_the_file(tmp_path: Path, grid: DensityGrid) -> None:
    with pytest.raises(VolumeError, match=r"cannot write.*absent"):
        write_volume(tmp_path / "absent" / "c.npz", grid)
    with pytest.raises(VolumeError, match=r"\.npz, \.vol"):
        write_volume(tmp_path / "c.vdb", grid)


def test_a_zip_bomb_is_refused_before_it_is_inflated(tmp_path: Path) -> None:
    voxels = 1025**3
    assert voxels > LARGEST_VOXEL_COUNT
    head = npy_bytes((1025, 1025, 1025), b"")
    archive = bytearray(npz_bytes(density=head + b"\0" * 1_000_000))
    directory = archive.rfind(b"PK\x01\x02")
    claimed = struct.pack("<I", len(head) + 8 * 1024**2)  # central directory: uncompressed size
    archive[directory + 24 : directory + 28] = claimed
    with pytest.raises(VolumeError, match="more than its compressed data can hold"):
        read_volume(written(tmp_path, "liar.npz", bytes(archive)))
    honest = npz_bytes(density=head + b"\0" * 1_000_000)
    with pytest.raises(VolumeError, match="at most"):
        read_volume(written(tmp_path, "bomb.npz", honest))


def test_promises_are_refused_without_allocating(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise AssertionError("allocated before the promise was checked")

    for name in ("empty", "zeros", "fromfile", "frombuffer", "array"):
        monkeypatch.setattr(np, name, refuse)
    for case in ("vol that promises the moon", "npy that promises the moon", "npz member that promises more"):
        name, data, _ = BAD_FILES[case]
        with pytest.raises(VolumeError):
            read_volume(written(tmp_path, name, data))


@FUZZ
@given(data=st.binary(max_size=200), suffix=st.sampled_from([".npz", ".npy", ".vol"]))
def test_random_bytes_end_in_a_volume_error(tmp_path: Path, data: bytes, suffix: str) -> None:
    with pytest.raises(VolumeError):
        read_volume(written(tmp_path, f"fuzz{suffix}", data))


VALID = {".vol": vol_bytes(), ".npy": as_npy(np.ones((2, 2, 2), np.float32))}
VALID[".npz"] = npz_bytes(density=VALID[".npy"], voxel_size_m=as_npy(2.0))


@FUZZ
@given(
    suffix=st.sampled_from(sorted(VALID)),
    flips=st.lists(st.tuples(st.integers(0, 399), st.integers(0, 255)), max_size=4),
    cut=st.one_of(st.none(), st.integers(0, 399)),
)
def test_damaged_files_are_read_or_refused(
    tmp_path: Path, suffix: str, flips: list[tuple[int, int]], cut: int | None
) -> None:
    data = bytearray(VALID[suffix])
    for position, value in flips:
        data[position % len(data)] = value
    try:
        grid = read_volume(written(tmp_path, f"fuzz{suffix}", bytes(data[:cut])))
    except VolumeError:
        return
    assert torch.isfinite(grid.density).all()


@pytest.mark.filterwarnings("ignore:Reading `.npy` or `.npz` file required additional header parsing:UserWarning")
@FUZZ
@given(header=st.text(alphabet="{}()[]'\":, descrfotanshape<4TrueFals0123456789L-", max_size=120))
def test_random_npy_headers_end_in_a_volume_error(tmp_path: Path, header: str) -> None:
    text = header.encode()
    data = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text
    with pytest.raises(VolumeError):
        read_volume(written(tmp_path, "fuzz.npy", data))


def test_deeply_nested_headers_are_refused(tmp_path: Path) -> None:
    text = b"(" * 9_000
    with pytest.raises(VolumeError):
        read_volume(written(tmp_path, "deep.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text))


def test_a_flipped_bit_in_an_npz_is_noticed(tmp_path: Path) -> None:
    values = np.random.default_rng(1).random((4, 4, 4), np.float32)
    data = bytearray(npz_bytes(zipfile.ZIP_STORED, density=as_npy(values)))
    data[300] ^= 1
    with pytest.raises(VolumeError, match="CRC"):
        read_volume(written(tmp_path, "flip.npz", bytes(data)))


class FakeTransform:
    """Index to world with voxels of 2 and a shift, optionally mirrored along x as a foreign tool might write it."""

    def __init__(self, mirrored: bool) -> None:
        self.sign = -1.0 if mirrored else 1.0

    def voxelSize(self) -> tuple[float, float, float]:
        return (2.0, 2.0, 2.0)

    def indexToWorld(self, index: Sequence[float]) -> tuple[float, ...]:
        return (self.sign * 2.0 * index[0], 2.0 * index[1] + 1.0, 2.0 * index[2])


def fake_openvdb(names: Sequence[str], dense: np.ndarray, mirrored: bool = False) -> types.ModuleType:
    """The few calls of the OpenVDB module that the reader makes, as its documentation describes them."""

    class FloatGrid:
        transform = FakeTransform(mirrored)

        def __init__(self, name: str) -> None:
            self.name = name

        def evalActiveVoxelBoundingBox(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
            first = (5, 6, 7)
            return first, tuple(a + n - 1 for a, n in zip(first, dense.shape, strict=True))

        def copyToArray(self, array: np.ndarray, ijk: Sequence[int]) -> None:
            assert tuple(ijk) == (5, 6, 7)
            array[:] = dense if self.name == "density" else 0.0

    module = types.ModuleType("openvdb")
    grids = [FloatGrid(name) for name in names]
    readers: dict[str, Callable[..., object]] = {
        "readAllGridMetadata": lambda path: grids,
        "read": lambda path, name: next(grid for grid in grids if grid.name == name),
    }
    vars(module).update(readers)
    return module


def test_vdb_is_turned_from_y_up_to_z_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dense = np.arange(24, dtype=np.float32).reshape(2, 3, 4)  # (X, Y, Z), Y up
    monkeypatch.setitem(sys.modules, "openvdb", fake_openvdb(["heat", "density"], dense))
    grid = read_volume(written(tmp_path, "c.vdb", b"vdb"))
    assert grid.density.shape == (3, 4, 2)
    world = torch.tensor([2.0 * 6, 2.0 * 7 + 1.0, 2.0 * 9])  # voxel X, Y, Z = 6, 7, 9 of the file
    turned = torch.stack([world[0], -world[2], world[1]])
    assert float(grid.look_up_density(turned)) == dense[1, 1, 2]
    assert float(grid.look_up_density(turned * torch.tensor([1.0, -1.0, 1.0]))) != dense[1, 1, 2]


def test_vdb_with_nothing_usable_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, "c.vdb", b"vdb")
    dense = np.ones((2, 2, 2), np.float32)
    monkeypatch.setitem(sys.modules, "openvdb", fake_openvdb([], dense))
    with pytest.raises(VolumeError, match="no grid of float"):
        read_volume(path)
    monkeypatch.setitem(sys.modules, "openvdb", fake_openvdb(["density"], np.ones((0, 2, 2), np.float32)))
    with pytest.raises(VolumeError, match="empty"):
        read_volume(path)
    monkeypatch.setitem(sys.modules, "openvdb", fake_openvdb(["density"], dense, mirrored=True))
    with pytest.raises(VolumeError, match="mirrored"):
        read_volume(path)


def test_vdb_without_the_module_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("openvdb", "pyopenvdb"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(VolumeError, match="conda install -c conda-forge openvdb"):
        read_volume(written(tmp_path, "c.vdb", b"vdb"))
