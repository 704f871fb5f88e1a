"""A file written atomically appears whole or not at all."""

import os
import time
from pathlib import Path

import pytest

from render.atomic_write import atomic_path


def names_in(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


def test_the_file_appears_under_its_final_name_only(tmp_path: Path) -> None:
    path = tmp_path / "table.bin"
    with atomic_path(path) as temporary:
        temporary.write_bytes(b"whole")
        assert not path.exists()
        assert temporary.parent == path.parent
        assert temporary.suffix == path.suffix
    assert path.read_bytes() == b"whole"
    assert names_in(tmp_path) == ["table.bin"]


def test_a_failing_writer_leaves_the_old_file_and_no_leftovers(tmp_path: Path) -> None:
    path = tmp_path / "table.bin"
    path.write_bytes(b"old")

    def write_half() -> None:
        with atomic_path(path) as temporary:
            temporary.write_bytes(b"half")
            raise RuntimeError("disk on fire")

    with pytest.raises(RuntimeError, match="disk on fire"):
        write_half()
    assert path.read_bytes() == b"old"
    assert names_in(tmp_path) == ["table.bin"]


def test_two_writers_of_one_file_do_not_meet(tmp_path: Path) -> None:
    path = tmp_path / "table.bin"
    with atomic_path(path) as first, atomic_path(path) as second:
        assert first != second
        first.write_bytes(b"first")
        second.write_bytes(b"second")
    assert path.read_bytes() == b"first"  # the outer block ends last


def test_leftovers_of_killed_writers_are_removed_but_live_and_foreign_files_are_not(tmp_path: Path) -> None:
    path = tmp_path / "table[1].bin"
    abandoned = tmp_path / ".table[1].00ff.part.bin"
    live = tmp_path / ".table[1].11ff.part.bin"
    foreign = tmp_path / ".table1.22ff.part.bin"
    long_ago = time.time() - 7200.0
    for file in (abandoned, live, foreign):
        file.write_bytes(b"half")
    for file in (abandoned, foreign):
        os.utime(file, (long_ago, long_ago))
    with atomic_path(path) as temporary:
        temporary.write_bytes(b"whole")
    assert names_in(tmp_path) == sorted([live.name, foreign.name, path.name])
