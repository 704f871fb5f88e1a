"""Files that appear whole or not at all: written under a temporary name in the same folder, then renamed."""

import contextlib
import glob
import os
import secrets
import time
from collections.abc import Iterator
from pathlib import Path

# A live writer touches its file all the time; what nobody has touched for an hour belongs to a process that was killed.
_ABANDONED_AFTER_SECONDS = 3600.0


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Temporary path beside `path` that becomes `path` when the block ends, and vanishes when the block raises.

    The temporary name is unique, so that two processes writing the same file do not meet: the later one wins. It keeps
    the suffix of `path`, for libraries that choose a format by it. Leftovers of killed writers of `path` are removed.

    Args:
        path: the final name; its folder must exist.
    """
    _remove_leftovers(path)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(8)}.part{path.suffix}")
    try:
        yield temporary
        _flush_to_disk(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _flush_to_disk(path: Path) -> None:
    """Without this a power cut may leave the new name on an empty file."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _remove_leftovers(path: Path) -> None:
    for leftover in path.parent.glob(f".{glob.escape(path.stem)}.*.part{glob.escape(path.suffix)}"):
        # Another process may remove or finish the same file in between.
        with contextlib.suppress(OSError):
            if time.time() - leftover.stat().st_mtime > _ABANDONED_AFTER_SECONDS:
                leftover.unlink()
