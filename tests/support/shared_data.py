"""Access to the shared photographs, volumes and masks; a test that asks for an absent file is skipped."""

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2].parent / "shared"


def shared_file(name: str) -> Path:
    """Path of a file of the shared data; skips the running test where the data is absent."""
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"needs the shared data file {name}, which is not here")
    return path
