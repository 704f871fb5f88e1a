import math

import pytest

from render.errors import SceneError
from render.shafts.strict_table import StrictTable


def table(**values: object) -> StrictTable:
    return StrictTable(values, "scene.toml")


def test_values_are_read_by_kind() -> None:
    given = table(a=1, b=2.5, c=True, d="x", e=[1, 2, 3], f={"g": 1}, h=[{"i": 1}, {"i": 2}])
    assert (given.whole("a"), given.number("a"), given.number("b"), given.truth("c"), given.word("d")) == (
        1,
        1.0,
        2.5,
        True,
        "x",
    )
    assert given.triple("e") == (1.0, 2.0, 3.0)
    assert given.table("f").whole("g") == 1
    assert [part.whole("i") for part in given.tables("h")] == [1, 2]
    given.finish()
    assert table().number("z", 4.0) == 4.0
    assert table().tables("z") == []


def test_a_key_that_nobody_asks_for_is_an_error_with_file_and_key() -> None:
    given = table(width=3, widht=4)
    given.whole("width")
    with pytest.raises(SceneError, match=r"scene\.toml: unknown key 'widht'; known are width"):
        given.finish()


@pytest.mark.parametrize(
    ("method", "value"),
    [("number", "1"), ("number", True), ("number", math.nan), ("whole", 1.5), ("whole", True), ("truth", 1), ("word", 3),
     ("triple", [1, 2]),
     ("triple", [1, 2, "3"]), ("triple", [1, 2, math.inf]), ("table", 3), ("tables", {"a": 1}), ("tables", [1])],
)  # fmt: skip
def test_another_kind_is_an_error_that_names_it(method: str, value: object) -> None:
    with pytest.raises(SceneError, match=r"scene\.toml"):
        getattr(table(key=value), method)("key")


def test_a_missing_value_is_an_error() -> None:
    with pytest.raises(SceneError, match="key is missing"):
        table().number("key")
