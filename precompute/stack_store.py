"""Scattering stacks on disk: build one, or load the one that was built for just this volume, camera, sun and effort."""

import time
from dataclasses import dataclass, fields, replace
from pathlib import Path

import torch
from torch import Tensor

from precompute.error_budget import Effort
from precompute.scattering_orders import Progress, build_scattering_stack
from precompute.store import load_tables, save_tables, table_key
from render.camera import Camera
from render.density_grid import DensityGrid
from render.errors import StoreError
from render.scattering_stack import ScatteringTables

STACK_VERSION = 18
"""Raised whenever the numbers that the same arguments give change; older files are then built anew."""


@dataclass(frozen=True)
class StackReport:
    """Where a stack came from.

    Args:
        seconds: it took to build, or to load.
        reused: whether it was loaded.
        path: of its file, or None if it was not kept.
    """

    seconds: float
    reused: bool
    path: Path | None


def stack_key(
    grid: DensityGrid,
    camera: Camera,
    sun_direction: Tensor,
    asymmetry: Tensor,
    extinction: Tensor,
    effort: Effort,
    seed: int,
) -> str:
    """Hash of everything that a stack depends on; arguments as for `build_scattering_stack`."""
    return table_key(
        {
            "stack": STACK_VERSION,
            "density": grid.density,
            "lower": grid.lower,
            "upper": grid.upper,
            "camera": camera,
            "sun": sun_direction,
            "asymmetry": asymmetry,
            "extinction": extinction,
            "effort": effort,
            "seed": seed,
        }
    )


def load_or_build_stack(
    folder: Path | None,
    grid: DensityGrid,
    camera: Camera,
    sun_direction: Tensor,
    asymmetry: Tensor,
    extinction: Tensor,
    effort: Effort,
    seed: int = 0,
    on_progress: Progress = lambda stage, share: None,
) -> tuple[ScatteringTables, StackReport]:
    """Tables from a folder, or freshly built and kept there.

    Args:
        folder: of the stack files, made if needed; None keeps nothing.
        grid, camera, sun_direction, asymmetry, extinction, effort, seed, on_progress: as for `build_scattering_stack`.

    Returns:
        The tables, and where they came from. A stale, damaged or foreign file is replaced.

    Raises:
        StoreError: if the folder cannot be made, before anything is computed, or the file not be written.
    """
    started = time.perf_counter()
    key = stack_key(grid, camera, sun_direction, asymmetry, extinction, effort, seed)
    path = None if folder is None else folder / f"stack-{key[:16]}.safetensors"
    if path is not None:
        _make_folder(path.parent)
    if path is not None and path.exists():
        try:
            tables = load_stack(path, key)
            return tables, StackReport(time.perf_counter() - started, True, path)
        except StoreError:
            path.unlink(missing_ok=True)
    tables = build_scattering_stack(grid, camera, sun_direction, asymmetry, extinction, effort, seed, on_progress)
    seconds = time.perf_counter() - started
    if path is not None:
        save_stack(path, tables, key, {"effort": effort.__dict__, "seed": seed, "seconds": seconds})
    return round_tables(tables), StackReport(seconds, False, path)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"cannot make the folder {folder} for the tables: {error.strerror or error}") from error


def round_tables(tables: ScatteringTables) -> ScatteringTables:
    """Tables as a file holds them: the images of the orders from two upwards to 1 part in 2000 of each pixel."""
    return _unpack(tables, *_pack(tables))


def _pack(tables: ScatteringTables) -> tuple[Tensor, Tensor]:
    """Images relative to their means in half precision, which takes half the space, and the means `(knot, asymmetry, extinction)`."""
    mean = tables.multiple.sum(-1).double() / max(len(tables.pixel), 1)
    mean = mean.to(torch.float32)
    relative = torch.where(mean[..., None] > 0, tables.multiple / mean[..., None], 0.0)
    return relative.clamp(max=torch.finfo(torch.float16).max).to(torch.float16), mean


def _unpack(tables: ScatteringTables, relative: Tensor, mean: Tensor) -> ScatteringTables:
    return replace(tables, multiple=relative.to(torch.float32) * mean[..., None])


def save_stack(path: Path, tables: ScatteringTables, key: str, provenance: dict[str, object]) -> None:
    """Write tables under a key; `provenance` must be JSON. Raises StoreError if that fails."""
    tensors = {item.name: value for item in fields(tables) if isinstance(value := getattr(tables, item.name), Tensor)}
    tensors["multiple"], tensors["multiple_mean"] = _pack(tables)
    about = {
        **provenance,
        "width": tables.width,
        "height": tables.height,
        "groups": tables.groups,
        "torch": torch.__version__,
    }
    save_tables(path, tensors, about, key)


def load_stack(path: Path, key: str) -> ScatteringTables:
    """Read tables that `save_stack` wrote under the same key. Raises StoreError otherwise."""
    tensors, about = load_tables(path, key)
    try:
        mean, groups = tensors.pop("multiple_mean"), tuple(about["groups"])
        tables = ScatteringTables(width=int(about["width"]), height=int(about["height"]), groups=groups, **tensors)
        return _unpack(tables, tables.multiple, mean)
    except (KeyError, TypeError, ValueError) as error:
        raise StoreError(f"cannot load the stack {path}: other tables than expected ({error})") from error
