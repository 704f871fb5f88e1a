"""Tables of an atmosphere on disk: build them, or load those that were built for just this atmosphere and plan.

A build that was interrupted goes on after the last order that it finished.
"""

import contextlib
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from precompute.atmosphere_tables import (
    OrderState,
    Progress,
    TablePlan,
    build_first_order,
    build_next_order,
)
from precompute.store import load_tables, save_tables, table_key
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.tables import AtmosphereTables
from render.errors import ParameterError, StoreError

TABLES_VERSION = 1
"""Raised whenever the numbers that the same arguments give change; older files are then built anew."""


@dataclass(frozen=True)
class TablesReport:
    """Where tables came from.

    Args:
        seconds: it took to build, or to load.
        reused: whether they were loaded.
        resumed_order: the last order that an earlier, interrupted build had finished; 0 if there was none.
        path: of their file, or None if they were not kept.
    """

    seconds: float
    reused: bool
    resumed_order: int
    path: Path | None


def tables_key(atmosphere: AtmosphereParameters, plan: TablePlan) -> str:
    """Hash of everything that the tables depend on."""
    return table_key({"atmosphere tables": TABLES_VERSION, "atmosphere": atmosphere, "plan": plan})


def prepare_atmosphere_tables(
    atmosphere: AtmosphereParameters,
    plan: TablePlan | None = None,
    folder: Path | None = None,
    on_progress: Progress = lambda stage, share: None,
) -> tuple[AtmosphereTables, TablesReport]:
    """Load the tables of an atmosphere, or build and keep them.

    Args:
        atmosphere: the planet.
        plan: what is to be built; by default that of Bruneton's reference.
        folder: where tables are kept, made if needed; None to keep nothing.
        on_progress: told what is being done.

    Returns:
        The tables, and where they came from.

    Raises:
        StoreError: if they cannot be written. A file that is stale, truncated, damaged or foreign is built anew.
    """
    plan = plan or TablePlan()
    start = time.perf_counter()
    if folder is None:
        state, _ = _build(atmosphere, plan, None, "", on_progress)
        return state.tables(atmosphere), TablesReport(time.perf_counter() - start, False, 0, None)
    key = tables_key(atmosphere, plan)
    path = folder / f"atmosphere-{key[:16]}.safetensors"
    with contextlib.suppress(StoreError):
        tables = load_atmosphere_tables(path, atmosphere, plan)
        return tables, TablesReport(time.perf_counter() - start, True, 0, path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"cannot keep tables in {folder}: {error}; name another folder") from error
    partial = folder / f"atmosphere-{key[:16]}.partial.safetensors"
    state, resumed = _build(atmosphere, plan, partial, key, on_progress)
    tables = state.tables(atmosphere)
    seconds = time.perf_counter() - start
    save_atmosphere_tables(path, tables, plan, {"seconds": seconds})
    partial.unlink(missing_ok=True)
    return tables, TablesReport(seconds, False, resumed, path)


def save_atmosphere_tables(
    path: Path, tables: AtmosphereTables, plan: TablePlan, provenance: dict[str, object]
) -> None:
    """Write tables; `provenance` must be JSON. Raises StoreError if that fails."""
    about = {
        **provenance,
        "orders": tables.orders,
        "wavelengths": list(tables.atmosphere.wavelengths),
        "plan": repr(plan),
        "torch": torch.__version__,
    }
    tensors = {name: getattr(tables, name) for name in _TABLES}
    save_tables(path, tensors, about, tables_key(tables.atmosphere, plan))


def load_atmosphere_tables(path: Path, atmosphere: AtmosphereParameters, plan: TablePlan) -> AtmosphereTables:
    """Read tables that were made for the same atmosphere and plan. Raises StoreError otherwise."""
    tensors, about = load_tables(path, tables_key(atmosphere, plan))
    try:
        return AtmosphereTables(atmosphere, orders=int(about["orders"]), **tensors)
    except (KeyError, TypeError, ValueError, ParameterError) as error:
        raise StoreError(f"cannot load the tables {path}: other tables than expected ({error})") from error


_TABLES = ("transmittance", "irradiance", "scattering", "single_mie")
_STATE = (*_TABLES, "ground_irradiance")


def _build(
    atmosphere: AtmosphereParameters, plan: TablePlan, partial: Path | None, key: str, on_progress: Progress
) -> tuple[OrderState, int]:
    """The state after the last order, and the order from which an earlier build was taken up."""
    state = _load_state(partial, key) if partial is not None else None
    resumed = state.order if state is not None else 0
    state = state or build_first_order(atmosphere, plan, on_progress)
    while state.order < plan.orders:
        if partial is not None and state.order > resumed:
            _save_state(partial, state, key)
        state = build_next_order(atmosphere, plan, state, on_progress)
    return state, resumed


def _save_state(path: Path, state: OrderState, key: str) -> None:
    tensors: dict[str, Tensor] = {name: getattr(state, name) for name in _STATE}
    tensors |= {f"light_{number}": table for number, table in enumerate(state.light)}
    save_tables(path, tensors, {"order": state.order}, f"{key} partial")


def _load_state(path: Path, key: str) -> OrderState | None:
    """The state that an interrupted build left, or None if there is none that can be used."""
    try:
        tensors, about = load_tables(path, f"{key} partial")
        light = tuple(tensors.pop(name) for name in sorted(tensors) if name.startswith("light_"))
        return OrderState(order=int(about["order"]), light=light, density=None, **tensors)
    except (StoreError, KeyError, TypeError, ValueError):
        return None
