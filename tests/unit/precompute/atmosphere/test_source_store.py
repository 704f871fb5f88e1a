"""Source functions on disk."""

from pathlib import Path

import pytest
import torch

from precompute.atmosphere import source_budget, source_store
from precompute.atmosphere.source_function import SourceSizes
from precompute.atmosphere.source_store import load_or_build_source, source_key
from render.atmosphere.earth import earth
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.sun_columns import build_sun_columns


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_budget, "SourceSizes", lambda: SourceSizes(5, 9, 7, 5, 4, 6, 4, 4))
    monkeypatch.setattr(source_budget, "build_sun_columns", lambda shells: build_sun_columns(shells, 16, 48))


PLANET = earth((550e-9,))


def test_a_stored_source_is_read_back_and_a_damaged_one_built_again(tmp_path: Path) -> None:
    built, first = load_or_build_source(tmp_path, PLANET, tolerance=0.9, orders=2)
    again, second = load_or_build_source(tmp_path, PLANET, tolerance=0.9, orders=2)
    assert (first.reused, second.reused) == (False, True)
    assert first.path == second.path
    torch.testing.assert_close(again.source, built.source, rtol=0.0, atol=0.0)
    torch.testing.assert_close(again.sun_columns.columns, built.sun_columns.columns, rtol=0.0, atol=0.0)
    assert (again.orders, again.nodes) == (built.orders, built.nodes)
    assert second.provenance["orders"] == 2
    assert first.path is not None
    first.path.write_bytes(first.path.read_bytes()[:-100])
    assert not load_or_build_source(tmp_path, PLANET, tolerance=0.9, orders=2)[1].reused


def test_another_planet_tolerance_or_version_is_another_file(monkeypatch: pytest.MonkeyPatch) -> None:
    def key(planet: AtmosphereParameters = PLANET, tolerance: float = 0.9, orders: int | None = 2) -> str:
        return source_key(planet, tolerance, orders)

    keys = [key(), key(PLANET.with_aerosol(2.0)), key(tolerance=0.8), key(orders=3), key(orders=None)]
    assert len(set(keys)) == len(keys)
    before = key()
    monkeypatch.setattr(source_store, "SOURCE_VERSION", source_store.SOURCE_VERSION + 1)
    assert key() != before


def test_nothing_is_kept_without_a_folder() -> None:
    _, stored = load_or_build_source(None, PLANET, tolerance=0.9, orders=2)
    assert stored.path is None
