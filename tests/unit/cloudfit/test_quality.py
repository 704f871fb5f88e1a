"""Presets, and qualities for a tolerance."""

import pytest

from cloudfit.quality import QUALITIES, quality_for
from render.errors import ParameterError


def test_better_presets_work_harder_and_accept_less_error() -> None:
    draft, standard, reference = (QUALITIES[name] for name in ("draft", "standard", "reference"))
    for worse, better in ((draft, standard), (standard, reference)):
        assert worse.table_effort.paths < better.table_effort.paths
        assert worse.picture_effort.paths < better.picture_effort.paths
        assert worse.largest_image_error > better.largest_image_error
        assert (worse.table_effort.tolerance or 0.0) > (better.table_effort.tolerance or 0.0)
    assert (standard.asymmetry_nodes, len(standard.place_depths(0.05, 60.0))) == (11, 10)


@pytest.mark.parametrize(
    ("tolerance", "nearest"), [(0.5, "draft"), (0.05, "draft"), (0.03, "standard"), (0.003, "reference")]
)
def test_a_tolerance_takes_the_nearest_preset_and_as_many_paths_as_it_needs(tolerance: float, nearest: str) -> None:
    preset, quality = QUALITIES[nearest], quality_for(tolerance)
    known = preset.table_effort.tolerance
    assert known is not None
    assert quality.table_effort.tolerance == quality.picture_effort.tolerance == tolerance
    assert quality.table_effort.points == preset.table_effort.points
    assert quality.asymmetry_nodes == preset.asymmetry_nodes
    assert quality.table_effort.paths == pytest.approx(preset.table_effort.paths * (known / tolerance) ** 2, abs=1)


@pytest.mark.parametrize("name", QUALITIES)
def test_the_tolerance_of_a_preset_is_the_preset_for_tables(name: str) -> None:
    tolerance = QUALITIES[name].table_effort.tolerance
    assert tolerance is not None
    assert quality_for(tolerance).table_effort == QUALITIES[name].table_effort


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 0.0009, 1.1, float("nan")])
def test_tolerances_out_of_reach_are_refused(tolerance: float) -> None:
    with pytest.raises(ParameterError, match="tolerance"):
        quality_for(tolerance)


def test_seconds_limit_the_table_alone() -> None:
    limited = QUALITIES["draft"].limited(3.0)
    assert limited.table_effort.max_seconds == 3.0
    assert limited.picture_effort == QUALITIES["draft"].picture_effort
