"""TOML tables read strictly: every key is known, of the right kind, and used."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from render.errors import SceneError


@dataclass
class StrictTable:
    """A table whose keys are taken one by one; what is left over in the end is an error.

    Args:
        values: the table.
        place: the file, and where in it, for messages.
    """

    values: Mapping[str, Any]
    place: str
    _taken: set[str] = field(default_factory=set)

    def number(self, key: str, default: float | None = None) -> float:
        """A number, which may be infinite. Raises SceneError for anything else, or for a missing one without default."""
        value = self._take(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise SceneError(f"{self.place}: {key} must be a number, got {value!r}")
        return float(value)

    def whole(self, key: str, default: int | None = None) -> int:
        """A whole number."""
        value = self._take(key, default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise SceneError(f"{self.place}: {key} must be a whole number, got {value!r}")
        return value

    def truth(self, key: str, default: bool | None = None) -> bool:
        """True or false."""
        value = self._take(key, default)
        if not isinstance(value, bool):
            raise SceneError(f"{self.place}: {key} must be true or false, got {value!r}")
        return value

    def word(self, key: str, default: str | None = None) -> str:
        """A text."""
        value = self._take(key, default)
        if not isinstance(value, str):
            raise SceneError(f"{self.place}: {key} must be a text, got {value!r}")
        return value

    def triple(self, key: str, default: tuple[float, float, float] | None = None) -> tuple[float, float, float]:
        """Three finite numbers."""
        first, second, third = self.numbers(key, 3, default)
        return first, second, third

    def numbers(self, key: str, count: int, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """So many finite numbers."""
        value = self._take(key, default)
        fits = isinstance(value, list | tuple) and len(value) == count
        if not fits or not all(_is_finite_number(part) for part in value):
            raise SceneError(f"{self.place}: {key} must be {count} finite numbers in brackets, got {value!r}")
        return tuple(float(part) for part in value)

    def has(self, key: str) -> bool:
        """Whether the key is there."""
        return key in self.values

    def table(self, key: str) -> "StrictTable":
        """A table within this one."""
        value = self._take(key, {})
        if not isinstance(value, dict):
            raise SceneError(f"{self.place}: expected a table [{key}], got {value!r}")
        return StrictTable(value, f"{self.place}, [{key}]")

    def tables(self, key: str) -> list["StrictTable"]:
        """Tables of one name, in brackets of their own; none if there is no such key."""
        value = self._take(key, [])
        if not isinstance(value, list) or not all(isinstance(part, dict) for part in value):
            raise SceneError(f"{self.place}: expected tables [[{key}]], got {value!r}")
        return [StrictTable(part, f"{self.place}, [[{key}]] number {n + 1}") for n, part in enumerate(value)]

    def finish(self) -> None:
        """Raise SceneError for keys that nobody has asked for."""
        unknown = sorted(set(self.values) - self._taken)
        if unknown:
            known = ", ".join(sorted(self._taken))
            raise SceneError(f"{self.place}: unknown key {', '.join(map(repr, unknown))}; known are {known}")

    def _take(self, key: str, default: Any) -> Any:
        self._taken.add(key)
        value = self.values.get(key, default)
        if value is None:
            raise SceneError(f"{self.place}: {key} is missing")
        return value


def _is_finite_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
