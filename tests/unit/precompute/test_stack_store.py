"""Stacks are built once, found again by all that they depend on, and built anew when their file is not what it should be."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from precompute import stack_store
from precompute.error_budget import Effort
from precompute.scattering_orders import build_scattering_stack
from precompute.stack_store import load_or_build_stack, load_stack, round_tables, save_stack, stack_key
from precompute.store import save_tables
from render.camera import Camera, PinholeCamera
from render.density_grid import DensityGrid
from render.errors import StoreError
from render.scattering_stack import ScatteringTables
from tests.support.volumes import scaled, towards, uniform_box, view_north


@dataclasses.dataclass(frozen=True)
class Request:
    """All that a stack depends on."""

    grid: DensityGrid = dataclasses.field(default_factory=uniform_box)
    camera: Camera = dataclasses.field(default_factory=lambda: view_north(4, 3, 6.0))
    sun: torch.Tensor = dataclasses.field(default_factory=lambda: towards(120.0, 30.0))
    asymmetry: torch.Tensor = dataclasses.field(default_factory=lambda: torch.tensor([0.0, 0.5]))
    extinction: torch.Tensor = dataclasses.field(default_factory=lambda: torch.tensor([0.1, 1.0]))
    effort: Effort = dataclasses.field(default_factory=lambda: Effort(orders=2, points=40, paths=200, strata=4))
    seed: int = 3

    @property
    def arguments(self) -> tuple[object, ...]:
        return tuple(getattr(self, field.name) for field in dataclasses.fields(self))


def same(first: ScatteringTables, second: ScatteringTables) -> bool:
    """Whether all but the seconds that they took is equal."""
    pairs = [(getattr(timeless(first), f.name), getattr(timeless(second), f.name)) for f in dataclasses.fields(first)]
    return all(torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b for a, b in pairs)


def timeless(tables: ScatteringTables) -> ScatteringTables:
    return dataclasses.replace(tables, groups=tuple({**group, "seconds": {}} for group in tables.groups))


def get(folder: Path | None, request: Request | None = None) -> tuple[ScatteringTables, stack_store.StackReport]:
    return load_or_build_stack(folder, *(request or Request()).arguments)  # type: ignore[arg-type]


def test_a_stack_is_built_once_and_read_back_equal(tmp_path: Path) -> None:
    built, first = get(tmp_path / "new" / "folder")
    loaded, second = get(tmp_path / "new" / "folder")
    assert (first.reused, second.reused) == (False, True)
    assert first.path == second.path
    assert first.path is not None
    assert first.path.is_file()
    assert same(built, loaded)
    assert built.groups == loaded.groups
    assert len(built.groups) == 2
    assert same(built, round_tables(build_scattering_stack(*Request().arguments)))  # type: ignore[arg-type]
    assert first.seconds > 0.0


def test_without_a_folder_nothing_is_kept(tmp_path: Path) -> None:
    _, report = get(None)
    assert report.path is None
    assert not report.reused
    assert not list(tmp_path.iterdir())


CHANGES: dict[str, Callable[[Request], Request]] = {
    "density": lambda r: dataclasses.replace(r, grid=DensityGrid(0.5 * r.grid.density, r.grid.lower, r.grid.upper)),
    "box": lambda r: dataclasses.replace(r, grid=scaled(r.grid, 1.01)),
    "pixels": lambda r: dataclasses.replace(r, camera=r.camera.resized(5, 3)),
    "view": lambda r: dataclasses.replace(r, camera=view_north(4, 3, 6.1)),
    "kind of camera": lambda r: dataclasses.replace(
        r, camera=PinholeCamera((0.0, -50.0, 0.0), (0.0, 0.0, 0.0), 0.1, 4, 3)
    ),
    "up": lambda r: dataclasses.replace(r, camera=dataclasses.replace(view_north(4, 3, 6.0), up=(1.0, 0.0, 0.0))),
    "sun": lambda r: dataclasses.replace(r, sun=towards(120.0, 30.1)),
    "asymmetry": lambda r: dataclasses.replace(r, asymmetry=torch.tensor([0.0, 0.51])),
    "extinction": lambda r: dataclasses.replace(r, extinction=torch.tensor([0.1, 1.1])),
    "orders": lambda r: dataclasses.replace(r, effort=dataclasses.replace(r.effort, orders=3)),
    "points": lambda r: dataclasses.replace(r, effort=dataclasses.replace(r.effort, points=21)),
    "paths": lambda r: dataclasses.replace(r, effort=dataclasses.replace(r.effort, paths=201)),
    "strata": lambda r: dataclasses.replace(r, effort=dataclasses.replace(r.effort, strata=5)),
    "tail": lambda r: dataclasses.replace(r, effort=dataclasses.replace(r.effort, tail=True)),
    "tolerance": lambda r: dataclasses.replace(r, effort=dataclasses.replace(r.effort, tolerance=0.05)),
    "seconds": lambda r: dataclasses.replace(r, effort=dataclasses.replace(r.effort, max_seconds=5.0)),
    "seed": lambda r: dataclasses.replace(r, seed=4),
}


@pytest.mark.parametrize("change", CHANGES)
def test_all_that_matters_changes_the_key(change: str) -> None:
    key = stack_key(*Request().arguments)  # type: ignore[arg-type]
    assert stack_key(*Request().arguments) == key  # type: ignore[arg-type]
    assert stack_key(*CHANGES[change](Request()).arguments) != key  # type: ignore[arg-type]


def test_another_version_changes_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    key = stack_key(*Request().arguments)  # type: ignore[arg-type]
    monkeypatch.setattr(stack_store, "STACK_VERSION", stack_store.STACK_VERSION + 1)
    assert stack_key(*Request().arguments) != key  # type: ignore[arg-type]


def test_stacks_of_other_requests_live_side_by_side(tmp_path: Path) -> None:
    get(tmp_path)
    _, other = get(tmp_path, CHANGES["seed"](Request()))
    assert not other.reused
    assert len(list(tmp_path.iterdir())) == 2
    assert get(tmp_path)[1].reused


def stored(folder: Path) -> tuple[ScatteringTables, Path]:
    tables, report = get(folder)
    assert report.path is not None
    return tables, report.path


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-50] ^= 1
    path.write_bytes(bytes(content))


def empty(path: Path) -> None:
    path.write_bytes(b"")


def replace_by_text(path: Path) -> None:
    path.write_text("no table")


def store_under_another_key(path: Path) -> None:
    save_tables(path, {"pixel": torch.zeros(3)}, {}, "0" * 64)


def store_other_tables(path: Path) -> None:
    save_tables(path, {"pixel": torch.zeros(3)}, {"width": 1, "height": 1}, stack_key(*Request().arguments))  # type: ignore[arg-type]


def store_no_sizes(path: Path) -> None:
    save_tables(path, {"pixel": torch.zeros(3)}, {}, stack_key(*Request().arguments))  # type: ignore[arg-type]


DAMAGES = [truncate, flip, empty, replace_by_text, store_under_another_key, store_other_tables, store_no_sizes]


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_no_such_stack_is_built_anew(damage: Callable[[Path], None], tmp_path: Path) -> None:
    tables, path = stored(tmp_path)
    damage(path)
    with pytest.raises(StoreError, match=path.name):
        load_stack(path, stack_key(*Request().arguments))  # type: ignore[arg-type]
    rebuilt, report = get(tmp_path)
    assert not report.reused
    assert same(rebuilt, tables)
    assert get(tmp_path)[1].reused


def test_a_view_without_cloud_is_kept_too(tmp_path: Path) -> None:
    beside = dataclasses.replace(Request(), camera=PinholeCamera((0.0, -9.0, 0.0), (0.0, -10.0, 0.0), 0.5, 2, 2))
    tables, _ = get(tmp_path, beside)
    loaded, report = get(tmp_path, beside)
    assert report.reused
    assert same(loaded, tables)
    assert len(loaded.pixel) == 0


def test_files_hold_images_to_one_part_in_two_thousand() -> None:
    tables = build_scattering_stack(*Request().arguments)  # type: ignore[arg-type]
    rounded = round_tables(tables)
    ratio = rounded.multiple / tables.multiple
    assert 0.0 < float((ratio - 1.0).abs().max()) < 1.0 / 2000.0
    assert torch.equal(rounded.single, tables.single)


@pytest.mark.parametrize("scale", [1e-30, 1e-3, 1e30])
def test_rounding_has_no_scale_and_keeps_black_images(scale: float) -> None:
    """High orders of thin clouds are far below what half precision holds by itself."""
    tables = build_scattering_stack(*Request().arguments)  # type: ignore[arg-type]
    multiple = scale * tables.multiple
    multiple[:, 0] = 0.0
    rounded = round_tables(dataclasses.replace(tables, multiple=multiple)).multiple
    torch.testing.assert_close(rounded, multiple, rtol=1.0 / 2000.0, atol=0.0)
    assert not rounded[:, 0].any()


def test_provenance_must_be_json(tmp_path: Path) -> None:
    tables, path = stored(tmp_path)
    with pytest.raises(StoreError, match="JSON"):
        save_stack(path, tables, "0" * 64, {"what": object()})


def test_a_folder_that_cannot_be_made_is_refused_before_anything_is_computed(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    stages: list[str] = []
    with pytest.raises(StoreError, match=r"cannot make the folder .*file.*tables"):
        load_or_build_stack(
            tmp_path / "file" / "tables", *Request().arguments, on_progress=lambda stage, share: stages.append(stage)
        )
    assert stages == []
