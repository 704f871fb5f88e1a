"""Source functions on disk: build one, or load the one that was built for just this planet and tolerance."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from precompute.atmosphere.source_budget import Progress, build_source_function
from precompute.store import load_tables, save_tables, table_key
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.shells import cut_into_shells
from render.atmosphere.source_function import SourceFunction
from render.atmosphere.sun_columns import SunColumns
from render.errors import ParameterError, StoreError

SOURCE_VERSION = 1
"""Raised whenever the numbers that the same arguments give change; older files are then built anew."""


@dataclass(frozen=True)
class StoredSource:
    """Where a source function came from.

    Args:
        reused: whether it was loaded.
        path: of its file, or None if it was not kept.
        provenance: how it was made: the numbers of its `SourceReport`.
    """

    reused: bool
    path: Path | None
    provenance: dict[str, object]


def source_key(atmosphere: AtmosphereParameters, tolerance: float, orders: int | None) -> str:
    """Hash of everything that a source function depends on; arguments as for `build_source_function`."""
    return table_key(
        {"source": SOURCE_VERSION, "atmosphere": atmosphere, "tolerance": float(tolerance), "orders": orders}
    )


def load_or_build_source(
    folder: Path | None,
    atmosphere: AtmosphereParameters,
    *,
    tolerance: float = 0.01,
    orders: int | None = None,
    on_progress: Progress = lambda stage, share: None,
) -> tuple[SourceFunction, StoredSource]:
    """A source function from a folder, or freshly built and kept there.

    Args:
        folder: of the files, made if needed; None keeps nothing.
        atmosphere, tolerance, orders, on_progress: as for `build_source_function`.

    Returns:
        The source function, and where it came from. A stale, damaged or foreign file is replaced.
    """
    key = source_key(atmosphere, tolerance, orders)
    path = None if folder is None else folder / f"atmosphere-{key[:16]}.safetensors"
    if path is not None and path.exists():
        try:
            source, provenance = _load(path, key, atmosphere)
            return source, StoredSource(True, path, provenance)
        except StoreError:
            path.unlink(missing_ok=True)
    source, report = build_source_function(atmosphere, tolerance=tolerance, orders=orders, on_progress=on_progress)
    remainder = report.remainder if math.isfinite(report.remainder) else None  # JSON has no infinity
    provenance = {**asdict(report), "remainder": remainder, "nodes": source.nodes, "torch": torch.__version__}
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        tensors = {
            "source": source.source,
            "sky_irradiance": source.sky_irradiance,
            "sun_columns": source.sun_columns.columns,
        }
        save_tables(path, tensors, provenance, key)
    return source, StoredSource(False, path, provenance)


def _load(path: Path, key: str, atmosphere: AtmosphereParameters) -> tuple[SourceFunction, dict[str, object]]:
    tensors, about = load_tables(path, key)
    try:
        source = SourceFunction(
            cut_into_shells(atmosphere),
            SunColumns(atmosphere, tensors["sun_columns"]),
            tensors["source"],
            tensors["sky_irradiance"],
            int(about["orders"]),
            int(about["nodes"]),
        )
    except (KeyError, TypeError, ValueError, ParameterError) as error:
        raise StoreError(f"cannot load the source function {path}: other tables than expected ({error})") from error
    return source, about
