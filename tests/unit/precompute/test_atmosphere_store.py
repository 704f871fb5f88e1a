"""Tables on disk: reused only for the same atmosphere and plan, rebuilt if damaged, resumed if interrupted."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from precompute import atmosphere_store
from precompute.atmosphere.quadratures import PARITY, LineRule
from precompute.atmosphere_store import load_atmosphere_tables, prepare_atmosphere_tables, tables_key
from precompute.atmosphere_tables import TablePlan, build_atmosphere_tables
from render.atmosphere.earth import earth
from render.atmosphere.tables import TableSizes
from render.errors import StoreError

TINY = TableSizes(8, 16, 4, 8, 3, 6, 3, 4)
PLAN = TablePlan(sizes=TINY, orders=3)


def test_tables_are_kept_and_reused(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    built, first = prepare_atmosphere_tables(earth(), PLAN, folder)
    assert not first.reused
    loaded, second = prepare_atmosphere_tables(earth(), PLAN, folder)
    assert second.reused
    assert second.path == first.path
    for name in ("transmittance", "irradiance", "scattering", "single_mie"):
        assert torch.equal(getattr(built, name), getattr(loaded, name))
    assert loaded.orders == 3
    assert [file.name for file in folder.iterdir()] == [first.path.name]


@pytest.mark.parametrize(
    ("atmosphere", "plan"),
    [
        (earth().with_aerosol(1.1), PLAN),
        (earth((680e-9, 550e-9, 441e-9)), PLAN),
        (replace(earth(), mie_asymmetry=0.81), PLAN),
        (earth(), replace(PLAN, orders=2)),
        (earth(), replace(PLAN, precision="float32")),
        (earth(), replace(PLAN, quadratures=replace(PARITY, transmittance=LineRule("trapezoid", 400)))),
        (earth(), replace(PLAN, sizes=replace(TINY, suns=5))),
    ],
)
def test_other_dependencies_have_other_keys(atmosphere, plan: TablePlan) -> None:
    assert tables_key(atmosphere, plan) != tables_key(earth(), PLAN)
    assert tables_key(earth(), PLAN) == tables_key(earth(), replace(PLAN))


def test_truncated_stale_and_foreign_files_are_built_anew(tmp_path: Path) -> None:
    tables, report = prepare_atmosphere_tables(earth(), PLAN, tmp_path)
    assert report.path is not None
    whole = report.path.read_bytes()
    _, other = prepare_atmosphere_tables(earth().with_aerosol(2.0), PLAN, tmp_path)
    assert other.path is not None
    stale = other.path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"not a table", stale, whole[:-1] + bytes([whole[-1] ^ 1])):
        report.path.write_bytes(content)
        with pytest.raises(StoreError):
            load_atmosphere_tables(report.path, earth(), PLAN)
        again, rebuilt = prepare_atmosphere_tables(earth(), PLAN, tmp_path)
        assert not rebuilt.reused
        assert torch.equal(again.scattering, tables.scattering)
        assert prepare_atmosphere_tables(earth(), PLAN, tmp_path)[1].reused


class InterruptedError(Exception):
    """Stands for Ctrl-C."""


def interrupt_in(order: int):
    def report(stage: str, share: float) -> None:
        if stage == f"order {order}":
            raise InterruptedError

    return report


def test_an_interrupted_build_goes_on_after_the_last_finished_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InterruptedError):
        prepare_atmosphere_tables(earth(), PLAN, tmp_path, interrupt_in(3))
    partial = list(tmp_path.iterdir())
    assert len(partial) == 1
    assert ".partial." in partial[0].name
    stages: list[str] = []
    tables, report = prepare_atmosphere_tables(earth(), PLAN, tmp_path, lambda stage, share: stages.append(stage))
    assert report.resumed_order == 2
    assert set(stages) == {"order 3"}
    assert torch.equal(tables.scattering, build_atmosphere_tables(earth(), PLAN).scattering)
    assert [file.name for file in tmp_path.iterdir()] == [report.path.name if report.path else ""]
    monkeypatch.setattr(atmosphere_store, "TABLES_VERSION", atmosphere_store.TABLES_VERSION + 1)
    assert not prepare_atmosphere_tables(earth(), PLAN, tmp_path)[1].reused


def test_a_damaged_partial_file_is_not_used(tmp_path: Path) -> None:
    with pytest.raises(InterruptedError):
        prepare_atmosphere_tables(earth(), PLAN, tmp_path, interrupt_in(2))
    partial = next(tmp_path.iterdir())
    partial.write_bytes(partial.read_bytes()[:-3])
    _, report = prepare_atmosphere_tables(earth(), PLAN, tmp_path)
    assert report.resumed_order == 0


def test_nothing_is_kept_without_a_folder_and_a_folder_that_cannot_be_is_an_error(tmp_path: Path) -> None:
    _, report = prepare_atmosphere_tables(earth(), replace(PLAN, orders=1))
    assert report.path is None
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(StoreError, match="another folder"):
        prepare_atmosphere_tables(earth(), PLAN, file)
