"""The table store: what is saved is loaded, and nothing else ever is."""

import json
import multiprocessing
import os
import signal
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.torch import save_file

from precompute.store import load_tables, save_tables, table_key
from render.errors import ParameterError, StoreError

KEY = table_key({"seed": 1})
OTHER_KEY = table_key({"seed": 2})
PROVENANCE = {"seconds": 1.5, "nodes": [0.0, 0.5], "versions": {"torch": "2"}}


def tables() -> dict[str, torch.Tensor]:
    values = torch.arange(24.0).reshape(2, 3, 4)
    return {"table": values, "turned": values.permute(2, 0, 1), "nodes": torch.tensor([0.1, 0.2], dtype=torch.float64)}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "stack.safetensors"
    save_tables(file, tables(), PROVENANCE, KEY)
    return file


def test_saved_tables_are_loaded_exactly(path: Path) -> None:
    tensors, provenance = load_tables(path, KEY)
    assert sorted(tensors) == ["nodes", "table", "turned"]
    for name, expected in tables().items():
        assert torch.equal(tensors[name], expected)
        assert tensors[name].dtype == expected.dtype
    assert provenance == PROVENANCE
    assert [file.name for file in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("values", [torch.tensor(1.5), torch.empty(0, 3), torch.tensor([True, False]), torch.arange(3)])
def test_any_shape_and_type_survives(tmp_path: Path, values: torch.Tensor) -> None:
    save_tables(tmp_path / "t", {"a": values, "same": values}, {}, KEY)
    tensors, _ = load_tables(tmp_path / "t", KEY)
    assert torch.equal(tensors["a"], values)
    assert tensors["a"].shape == values.shape


def test_a_stale_file_is_refused(path: Path) -> None:
    with pytest.raises(StoreError, match=r"stack\.safetensors: stale"):
        load_tables(path, OTHER_KEY)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="no such file"):
        load_tables(tmp_path / "absent", KEY)
    with pytest.raises(StoreError, match="no such file"):
        load_tables(tmp_path, KEY)


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "foreign"
    for data in (b"", b"\0", b"\x80\x04N.", b"PK\x03\x04" * 20, os.urandom(1000)):
        file.write_bytes(data)
        with pytest.raises(StoreError, match="foreign"):
            load_tables(file, KEY)
    save_file({"table": torch.ones(3)}, file)
    with pytest.raises(StoreError, match="foreign, expected the format 'cloudfit tables 1', not None"):
        load_tables(file, KEY)


def test_a_file_cut_anywhere_is_refused(path: Path) -> None:
    data = path.read_bytes()
    for length in range(0, len(data), 7):
        path.write_bytes(data[:length])
        with pytest.raises(StoreError, match="truncated"):
            load_tables(path, KEY)


def test_a_header_that_promises_more_than_the_file_holds_is_refused_at_once(path: Path) -> None:
    def with_header(header: dict[str, object]) -> bytes:
        text = json.dumps(header).encode()
        return struct.pack("<Q", len(text)) + text + b"\0" * 16

    elements = 2**40
    promises = {"F32": [elements], "offsets": [0, 4 * elements]}
    header = {"table": {"dtype": "F32", "shape": promises["F32"], "data_offsets": promises["offsets"]}}
    started = time.monotonic()
    for data in (with_header(header), struct.pack("<Q", 2**62) + b"{}", struct.pack("<Q", 90_000_000) + b"{}"):
        path.write_bytes(data)
        with pytest.raises(StoreError, match="truncated"):
            load_tables(path, KEY)
    assert time.monotonic() - started < 5.0


def test_every_flipped_bit_is_noticed_or_harmless(path: Path) -> None:
    data = path.read_bytes()
    refused = 0
    for position in range(len(data)):
        damaged = bytearray(data)
        damaged[position] ^= 1 << (position % 8)
        path.write_bytes(bytes(damaged))
        try:
            tensors, provenance = load_tables(path, KEY)
        except StoreError:
            refused += 1
            continue
        assert provenance == PROVENANCE
        assert all(torch.equal(tensors[name], expected) for name, expected in tables().items())
    assert refused >= len(data) - 8  # up to eight bytes are blanks that pad the header


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(header=st.binary(max_size=120), length=st.one_of(st.none(), st.integers(0, 2**64 - 1)))
def test_random_bytes_end_in_a_store_error(tmp_path: Path, header: bytes, length: int | None) -> None:
    file = tmp_path / "fuzz"
    file.write_bytes(struct.pack("<Q", len(header) if length is None else length) + header)
    with pytest.raises(StoreError):
        load_tables(file, KEY)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_numbers_that_are_not_finite_neither_enter_nor_leave(tmp_path: Path, value: float) -> None:
    file = tmp_path / "t"
    bad = {"table": torch.tensor([1.0, value])}
    with pytest.raises(StoreError, match=r"save.*table holds numbers that are NaN or infinite"):
        save_tables(file, bad, {}, KEY)
    assert not file.exists()


def test_a_file_that_holds_nan_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "t"
    with monkeypatch.context() as patch:
        patch.setattr("precompute.store._check_finite", lambda *_: None)
        save_tables(file, {"table": torch.tensor([torch.nan])}, {}, KEY)
    with pytest.raises(StoreError, match=r"load.*NaN"):
        load_tables(file, KEY)


def test_provenance_must_be_json(tmp_path: Path) -> None:
    for provenance in ({"seconds": float("nan")}, {"path": tmp_path}):
        with pytest.raises(StoreError, match="not JSON"):
            save_tables(tmp_path / "t", {}, provenance, KEY)


def test_a_folder_that_does_not_exist_is_reported(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="cannot save"):
        save_tables(tmp_path / "absent" / "t", {"table": torch.ones(3)}, {}, KEY)


KILLED_WRITER = """
import sys, time, torch
import precompute.store as store

def half_a_file(tensors, path, metadata):
    with open(path, "wb") as file:
        file.write(b"half")
        file.flush()
        print("writing", flush=True)
        time.sleep(600)

store.save_file = half_a_file
store.save_tables(sys.argv[1], {"table": torch.ones(3)}, {}, "0" * 64)
"""


def test_a_killed_writer_leaves_no_half_written_file(tmp_path: Path) -> None:
    file = tmp_path / "t.safetensors"
    writer = subprocess.Popen(
        [sys.executable, "-c", KILLED_WRITER, str(file)], stdout=subprocess.PIPE, text=True, env={**os.environ}
    )
    assert writer.stdout is not None
    assert writer.stdout.readline() == "writing\n"
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    writer.stdout.close()
    leftovers = list(tmp_path.iterdir())
    assert [leftover.read_bytes() for leftover in leftovers] == [b"half"]
    assert not file.exists()
    save_tables(file, tables(), {}, KEY)
    load_tables(file, KEY)
    two_hours_ago = time.time() - 7200.0
    os.utime(leftovers[0], (two_hours_ago, two_hours_ago))
    save_tables(file, tables(), {}, KEY)
    assert list(tmp_path.iterdir()) == [file]


def _save_often(path: str, value: float) -> None:
    for _ in range(20):
        save_tables(path, {"table": torch.full((1000,), value)}, {"value": value}, KEY)


def test_two_processes_that_save_one_file_do_not_collide(tmp_path: Path) -> None:
    file = tmp_path / "t"
    _save_often(str(file), 0.0)
    other = multiprocessing.get_context("spawn").Process(target=_save_often, args=(str(file), 1.0))
    other.start()
    while other.is_alive():
        _save_often(str(file), 2.0)
        tensors, provenance = load_tables(file, KEY)
        assert bool((tensors["table"] == provenance["value"]).all())
    assert other.exitcode == 0
    assert list(tmp_path.iterdir()) == [file]


@dataclass(frozen=True)
class Sun:
    azimuth: float
    direction: torch.Tensor


def dependencies(**changes: object) -> dict[str, object]:
    base: dict[str, object] = {
        "version": "1",
        "seed": 3,
        "tolerance": 0.05,
        "exact": True,
        "nothing": None,
        "nodes": [0.1, 0.2],
        "density": torch.arange(6.0).reshape(2, 3),
        "sun": Sun(0.5, torch.tensor([0.0, 0.0, 1.0])),
        "box": {"lower": (0.0, 1.0)},
    }
    return {**base, **changes}


def test_equal_dependencies_have_equal_keys() -> None:
    key = table_key(dependencies())
    assert len(key) == 64
    assert table_key(dict(reversed(dependencies().items()))) == key
    strided = torch.arange(6.0).reshape(2, 3).T.contiguous().T
    assert table_key(dependencies(density=strided)) == key
    assert table_key(dependencies(density=np.arange(6, dtype=np.float32).reshape(2, 3))) == key
    assert table_key(dependencies(nodes=(0.1, 0.2))) == key
    assert table_key(dependencies(tolerance=np.float64(0.05))) == key


@pytest.mark.parametrize(
    "changes",
    [
        {"version": "2"},
        {"seed": 4},
        {"tolerance": 0.05 + 1e-15},
        {"exact": False},
        {"nodes": [0.2, 0.1]},
        {"nodes": torch.tensor([0.1, 0.2])},
        {"density": torch.arange(6.0).reshape(3, 2)},
        {"density": torch.arange(6.0, dtype=torch.float64).reshape(2, 3)},
        {"density": torch.arange(6.0).reshape(2, 3) + 1e-6},
        {"sun": Sun(0.5, torch.tensor([0.0, 0.0, -1.0]))},
        {"sun": Sun(0.6, torch.tensor([0.0, 0.0, 1.0]))},
        {"box": {"upper": (0.0, 1.0)}},
        {"one more": 1},
    ],
)
def test_any_change_changes_the_key(changes: dict[str, object]) -> None:
    assert table_key(dependencies(**changes)) != table_key(dependencies())


@pytest.mark.parametrize("value", [float("nan"), float("inf"), object(), b"bytes", {1, 2}, [object()], Sun])
def test_dependencies_that_cannot_be_hashed_are_named(value: object) -> None:
    with pytest.raises(ParameterError, match="odd"):
        table_key({"odd": value})


def test_the_key_of_known_dependencies_does_not_change() -> None:
    # A changed key would silently throw away every table that users have on disk.
    assert KEY == "1c239cce66c5a73cc04bb61d6fe90df557a5a5fc891d4fdba5bbb8a402987d0e"
