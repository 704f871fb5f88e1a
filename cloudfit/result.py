"""The file `result.json`: its schema, reading and writing, and whether it still answers the question that is asked."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cloudfit import __version__
from cloudfit.fit_types import FitOptions
from cloudfit.scene import Scene
from cloudfit.scene_record import volume_hash
from precompute.store import table_key
from render.atomic_write import atomic_path
from render.errors import ResultError

SCHEMA = "cloudfit result 1"
"""Written into every file; changes when a key changes its meaning or is removed, and older files are then fitted anew."""

RESULT_NAME = "result.json"

STATUSES = ("done", "failed", "no_cloud")

LARGEST_RESULT = 64 << 20
"""Bytes; a larger file is no result."""

NUMBER = (int, float)

_ALWAYS: dict[str, tuple[type, ...]] = {
    "reason": (str, type(None)),
    "interrupted": (bool,),
    "fingerprint": (str,),
    "photograph.file": (str,),
    "scene.volume.file": (str, type(None)),
    "scene.volume.sha256": (str,),
    "scene.camera.type": (str,),
    "scene.camera.width": (int,),
    "scene.camera.height": (int,),
    "scene.sun_azimuth_deg": NUMBER,
    "scene.sun_elevation_deg": NUMBER,
    "options.quality": (str,),
    "options.seed": (int,),
    "seconds.total": NUMBER,
    "versions": (dict,),
    "warnings": (list,),
    "files": (dict,),
}
"""Keys of every result, dots between the levels, and the types they may have."""

_DONE: dict[str, tuple[type, ...]] = {
    "photograph.sha256": (str,),
    "photograph.width": (int,),
    "photograph.height": (int,),
    "sunlight.colour": (list,),
    "mask.cloud_fraction": NUMBER,
    "search.stop_reason": (str,),
    "search.evaluations": (int,),
    "search.history": (list,),
    "candidates": (list,),
}
"""Keys of a result with the status "done"."""

_CANDIDATE: dict[str, tuple[type, ...]] = {
    "rank": (int,),
    "parameters": (dict,),
    "air_depth": (list,),
    "ambient_colour": (list,),
    "promised_loss": (*NUMBER, type(None)),
    "loss": (*NUMBER, type(None)),
    "floor": (*NUMBER, type(None)),
    "wasserstein_levels": (*NUMBER, type(None)),
    "picture": (str,),
}

_PARAMETER: dict[str, tuple[type, ...]] = {
    "value": NUMBER,
    "unit": (str,),
    "lower": NUMBER,
    "upper": NUMBER,
    "scale": (str,),
}


@dataclass(frozen=True)
class Question:
    """Everything that a result depends on.

    Args:
        photograph_sha256: of the photograph's bytes, or None if they cannot be read.
        mask_sha256: of the user's mask, or None.
        scene: volume, camera, sun.
        options: of the fit, seed included.
    """

    photograph_sha256: str | None
    mask_sha256: str | None
    scene: Scene
    options: FitOptions

    def fingerprint(self) -> str:
        """Hash of all of it and of the version of this code, 64 hexadecimal digits."""
        return table_key(
            {
                "schema": SCHEMA,
                "version": __version__,
                "photograph": self.photograph_sha256,
                "mask": self.mask_sha256,
                "volume": volume_hash(self.scene.grid),
                "camera": self.scene.camera,
                "sun_azimuth": self.scene.sun_azimuth,
                "sun_elevation": self.scene.sun_elevation,
                "options": self.options,
            }
        )


def write_result(path: Path, document: Mapping[str, Any]) -> None:
    """Write a result that `read_result` reads back; the file appears whole or not at all.

    Raises:
        ResultError: the document does not follow the schema, or holds a number that is not finite.
    """
    _check(path, document)
    try:
        text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False)
    except (TypeError, ValueError) as error:
        raise ResultError(f"cannot write the result {path}: {error}") from error
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_result(path: Path | str) -> dict[str, Any]:
    """Read and validate a result.

    Args:
        path: a `result.json`, or the folder that holds it.

    Returns:
        The document.

    Raises:
        ResultError: the file is missing, truncated, foreign or of another version, or lacks a key; names file and reason.
    """
    path = Path(path)
    path = path / RESULT_NAME if path.is_dir() else path
    try:
        if path.stat().st_size > LARGEST_RESULT:
            raise ResultError(f"cannot read the result {path}: it is larger than {LARGEST_RESULT >> 20} MiB")
        document = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except FileNotFoundError as error:
        raise ResultError(f"cannot read the result {path}: there is no such file") from error
    except OSError as error:
        raise ResultError(f"cannot read the result {path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise ResultError(f"cannot read the result {path}: truncated, damaged or not JSON ({error})") from error
    _check(path, document)
    return dict(document)


def result_matches(path: Path, fingerprint: str) -> bool:
    """Whether a folder holds a finished answer to just this question, with every file that it names.

    A result that failed or was interrupted does not count: it is worth another try.
    """
    try:
        document = read_result(path)
    except ResultError:
        return False
    if document["fingerprint"] != fingerprint or document["status"] == "failed" or document["interrupted"]:
        return False
    folder = path if path.is_dir() else path.parent
    return all((folder / name).is_file() for name in document["files"].values())


def finite_or_none(value: float) -> float | None:
    """The number, or None where JSON has no word for it."""
    return value if math.isfinite(value) else None


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number")


def _check(path: Path, document: Any) -> None:
    """Raise ResultError unless the document follows the schema."""
    if not isinstance(document, Mapping) or "schema" not in document:
        raise ResultError(f"{path} is no result of cloudfit: it does not name its schema")
    if document["schema"] != SCHEMA:
        raise ResultError(f"{path}: expected the schema {SCHEMA!r}, got {document['schema']!r}; fit it again")
    status = document.get("status")
    if status not in STATUSES:
        raise ResultError(f"{path}: expected a status out of {', '.join(STATUSES)}, got {status!r}")
    _check_keys(path, document, _ALWAYS, "")
    for name in document["files"].values():
        if not isinstance(name, str) or Path(name).name != name or name in ("", ".", ".."):
            raise ResultError(f"{path}: expected names of files beside it, got {name!r}")
    if status != "done":
        return
    _check_keys(path, document, _DONE, "")
    if not document["candidates"]:
        raise ResultError(f"{path}: expected at least one candidate, got none")
    for number, candidate in enumerate(document["candidates"], 1):
        _check_keys(path, candidate, _CANDIDATE, f"candidate {number}: ")
        for name, parameter in candidate["parameters"].items():
            _check_keys(path, parameter, _PARAMETER, f"candidate {number}: {name}.")


def _check_keys(path: Path, document: Any, keys: Mapping[str, tuple[type, ...]], prefix: str) -> None:
    for dotted, types in keys.items():
        value = document
        for key in dotted.split("."):
            if not isinstance(value, Mapping) or key not in value:
                raise ResultError(f"{path}: the key {prefix}{dotted} is missing; fit it again")
            value = value[key]
        if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
            expected = " or ".join(t.__name__ for t in types)
            raise ResultError(f"{path}: {prefix}{dotted} should be {expected}, not {type(value).__name__}")
