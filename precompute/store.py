"""Tables on disk: one safetensors file with its provenance, keyed by a hash of everything it depends on.

A file that is stale, truncated, damaged or foreign is refused with a `StoreError`, and the caller builds the table again;
it is never read as numbers. safetensors compares the header with the length of the file before anything is allocated.
"""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from render.atomic_write import atomic_path
from render.errors import ParameterError, StoreError

STORE_FORMAT = "cloudfit tables 1"
"""Written into every file; changes when the meaning of the metadata changes, and old files are then rebuilt."""


def table_key(dependencies: Mapping[str, object]) -> str:
    """Name of a table: a hash of everything that it depends on.

    Args:
        dependencies: by name: numbers, strings, booleans, None, tensors, arrays, and sequences, mappings and dataclasses
            of these. The version of the code that fills the table is one of them.

    Returns:
        64 hexadecimal digits. Equal dependencies give equal keys in any order and on any machine; 1 and 1.0 differ.

    Raises:
        ParameterError: for a dependency of another type, or a number that is not finite.
    """
    canonical = {name: _canonical(name, value) for name, value in dependencies.items()}
    text = json.dumps({"format": STORE_FORMAT, "dependencies": canonical}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _canonical(name: str, value: object) -> Any:
    """JSON that stands for a value; tensors are replaced by their hashes."""
    if isinstance(value, np.ndarray | np.generic):
        value = torch.from_numpy(np.ascontiguousarray(value)) if np.ndim(value) else value.item()
    if isinstance(value, Tensor):
        return {"tensor": _hash_tensor(value)}
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return value
    if isinstance(value, Mapping):
        return {"mapping": {str(key): _canonical(f"{name}.{key}", item) for key, item in value.items()}}
    if isinstance(value, Sequence) and not isinstance(value, bytes):
        return [_canonical(f"{name}[{index}]", item) for index, item in enumerate(value)]
    if is_dataclass(value) and not isinstance(value, type):
        members = {
            field.name: _canonical(f"{name}.{field.name}", getattr(value, field.name)) for field in fields(value)
        }
        return {type(value).__name__: members}
    raise ParameterError(
        f"the dependency {name} = {value!r} cannot be hashed; expected finite numbers, strings, tensors, "
        "and sequences, mappings or dataclasses of them"
    )


def _hash_tensor(tensor: Tensor) -> str:
    """Hash of type, shape and values, whatever the layout in memory."""
    values = tensor.detach().cpu().contiguous()
    digest = hashlib.sha256(f"{values.dtype} {tuple(values.shape)} ".encode())
    digest.update(values.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()


def _checksum(key: str, provenance: str, tensors: Mapping[str, Tensor]) -> str:
    """Hash of all that a file tells, so that a single flipped bit is noticed."""
    content = [STORE_FORMAT, key, provenance, *(f"{name} {_hash_tensor(tensors[name])}" for name in sorted(tensors))]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def save_tables(path: str | Path, tensors: Mapping[str, Tensor], provenance: Mapping[str, Any], key: str) -> None:
    """Write tables that `load_tables` reads back; the file appears whole or not at all.

    Args:
        path: the file; its folder must exist.
        tensors: tables by name, any shapes; finite.
        provenance: how the tables were made, as JSON: numbers, strings, lists and mappings.
        key: `table_key` of what they depend on.

    Raises:
        StoreError: for numbers that are not finite, provenance that is not JSON, or a file that cannot be written.
    """
    path = Path(path)
    _check_finite(path, tensors, "save")
    try:
        text = json.dumps(provenance, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise StoreError(f"cannot save the tables {path}: the provenance is not JSON ({error})") from error
    own = {name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format) for name, tensor in tensors.items()}
    metadata = {"format": STORE_FORMAT, "key": key, "provenance": text, "checksum": _checksum(key, text, own)}
    try:
        with atomic_path(path) as temporary:
            save_file(own, temporary, metadata=metadata)
    except (OSError, SafetensorError) as error:
        raise StoreError(f"cannot save the tables {path}: {error}") from error


def load_tables(path: str | Path, expected_key: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tables that `save_tables` wrote, if they are whole and depend on just what the caller asks for.

    Args:
        path: the file.
        expected_key: `table_key` of the caller's dependencies.

    Returns:
        The tables by name, and their provenance.

    Raises:
        StoreError: if the file is missing, stale, truncated, damaged or foreign, or holds numbers that are not finite;
            names the file and the reason.
    """
    path = Path(path)
    while True:
        version = _version(path)
        try:
            return _load_once(path, expected_key)
        except StoreError:
            # The library opens a file twice: another process that replaces it in between makes two halves that do not fit.
            if _version(path) == version:
                raise


def _version(path: Path) -> tuple[int, int] | None:
    """What tells a file from another that takes its place, None where there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns


def _load_once(path: Path, expected_key: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """As `load_tables`, of a file that nobody replaces meanwhile."""
    if not path.is_file():
        raise StoreError(f"cannot load the tables {path}: there is no such file")
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            metadata = file.metadata() or {}
            _check_identity(path, metadata, expected_key)
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118, not a mapping
    except (SafetensorError, OSError, ValueError, TypeError, KeyError, RuntimeError) as error:
        raise StoreError(f"cannot load the tables {path}: truncated, damaged or foreign ({error})") from error
    provenance = metadata.get("provenance", "")
    if metadata.get("checksum") != _checksum(expected_key, provenance, tensors):
        raise StoreError(f"cannot load the tables {path}: damaged, for the checksum is not that of the content")
    _check_finite(path, tensors, "load")
    return tensors, json.loads(provenance)


def _check_identity(path: Path, metadata: Mapping[str, str], expected_key: str) -> None:
    if metadata.get("format") != STORE_FORMAT:
        found = metadata.get("format")
        raise StoreError(f"cannot load the tables {path}: foreign, expected the format {STORE_FORMAT!r}, not {found!r}")
    if metadata.get("key") != expected_key:
        found = str(metadata.get("key"))
        raise StoreError(
            f"cannot load the tables {path}: stale, made for other dependencies (key {found[:12]}..., "
            f"expected {expected_key[:12]}...)"
        )


def _check_finite(path: Path, tensors: Mapping[str, Tensor], verb: str) -> None:
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise StoreError(f"cannot {verb} the tables {path}: {name} holds numbers that are NaN or infinite")
