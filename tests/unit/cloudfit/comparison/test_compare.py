from pathlib import Path

import pytest

from cloudfit.comparison.compare import Settings, compare
from cloudfit.comparison.experiment import SilentListener
from cloudfit.comparison.problems import Problem
from cloudfit.optimisers import OPTIMISERS
from render.errors import InputError, ParameterError, PhotographError
from tests.support.comparison import BowlSource

METHODS = {name: OPTIMISERS[name] for name in ("genetic", "crs2_lm")}


class Unusable(BowlSource):
    def load(self) -> Problem:
        raise PhotographError(f"{self.name} shows no cloud")


def test_a_comparison_ends_in_a_page_and_a_second_call_does_nothing_more(tmp_path: Path) -> None:
    settings = Settings(tmp_path / "out", evaluations=40, seeds=3)
    sources = [BowlSource("one"), Unusable("two", 0.95)]
    first = compare(sources, METHODS, settings)
    assert first.refused == {"two": "two shows no cloud"}
    assert first.page == tmp_path / "out" / "index.html"
    assert first.page.is_file()
    assert {row["method"] for row in first.document["methods"]} == set(METHODS)
    second = compare(sources, METHODS, settings)
    assert second.report.kept == second.report.total == 6
    assert second.document == first.document


def test_an_interruption_leaves_no_page(tmp_path: Path) -> None:
    class Impatient(SilentListener):
        def finished(self, record: object) -> None:
            raise KeyboardInterrupt

    stopped = compare([BowlSource("one")], METHODS, Settings(tmp_path, evaluations=40, seeds=3), Impatient())
    assert stopped.report.interrupted
    assert len(stopped.report.runs) == 1
    assert stopped.page is None
    assert not (tmp_path / "index.html").exists()


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two shows no cloud"):
        compare([Unusable("two", 0.95)], METHODS, Settings(tmp_path))
    with pytest.raises(ParameterError, match="at least one seed"):
        compare([BowlSource("one")], METHODS, Settings(tmp_path, seeds=0))
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot make"):
        compare([BowlSource("one")], METHODS, Settings(tmp_path / "file" / "out"))
