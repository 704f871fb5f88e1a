from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch

from render.depth_files import read_depth
from render.errors import PhotographError
from render.image_files import write_exr

DEPTH = np.array([[1.0, 2.5, np.inf], [4.0, 5.0, 1e10]], dtype=np.float32)


def write_channels(path: Path, channels: dict[str, np.ndarray]) -> Path:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
    return path


@pytest.mark.parametrize("name", ["Z", "depth.Z", "ViewLayer.Depth.Z", "V", "Y", "R"])
def test_a_depth_channel_is_found_by_any_of_its_names(tmp_path: Path, name: str) -> None:
    path = write_channels(tmp_path / "depth.exr", {name: DEPTH, "B": np.zeros_like(DEPTH)})
    assert torch.equal(read_depth(path), torch.from_numpy(DEPTH))


def test_the_likeliest_channel_wins_and_our_own_files_are_read(tmp_path: Path) -> None:
    path = write_channels(tmp_path / "both.exr", {"R": DEPTH + 1.0, "Z": DEPTH})
    assert torch.equal(read_depth(path), torch.from_numpy(DEPTH))
    write_exr(tmp_path / "own.exr", {"a_layer": torch.ones(2, 3), "distance": torch.from_numpy(DEPTH)})
    assert torch.equal(read_depth(tmp_path / "own.exr"), torch.from_numpy(DEPTH))


def test_numpy_files_are_read(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", DEPTH.astype(np.float64))
    assert torch.equal(read_depth(tmp_path / "depth.npy"), torch.from_numpy(DEPTH))


def test_what_is_no_depth_map_is_refused_by_name(tmp_path: Path) -> None:
    for name, array in (
        ("nan", DEPTH * np.nan),
        ("zero", np.zeros((2, 2))),
        ("cube", np.ones((2, 2, 2))),
        ("words", np.array([["a"]])),
    ):
        np.save(tmp_path / f"{name}.npy", array)
    (tmp_path / "torn.exr").write_bytes(write_channels(tmp_path / "whole.exr", {"Z": DEPTH}).read_bytes()[:40])
    (tmp_path / "torn.npy").write_bytes(b"\x93NUMPY")
    (tmp_path / "empty.npy").write_bytes(b"")
    write_channels(tmp_path / "other.exr", {"Q": DEPTH})
    write_channels(tmp_path / "colour.exr", {"R": DEPTH, "G": DEPTH + 1.0, "B": DEPTH})
    for name, words in (
        ("nan.npy", "above 0 m"),
        ("zero.npy", "above 0 m"),
        ("cube.npy", "one depth per pixel"),
        ("words.npy", "numbers"),
        ("torn.exr", "damaged"),
        ("torn.npy", "truncated"),
        ("empty.npy", "truncated"),
        ("other.exr", "got Q"),
        ("colour.exr", "coloured picture"),
        ("gone.exr", "no such file"),
        ("depth.png", "ends in .exr or .npy"),
    ):
        with pytest.raises(PhotographError, match=words) as error:
            read_depth(tmp_path / name)
        assert name in str(error.value)
