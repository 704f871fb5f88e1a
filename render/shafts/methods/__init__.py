"""The methods by name; each takes a scene that is ready and gives its in-scattered light."""

from collections.abc import Mapping
from types import MappingProxyType

from render.errors import ParameterError
from render.shafts.methods.base import Gathered, Method
from render.shafts.methods.brute_force import BruteForce

METHODS: Mapping[str, Method] = MappingProxyType({"brute_force": BruteForce()})
"""Every method with its usual settings."""


def find_method(name: str) -> Method:
    """The method of that name.

    Raises:
        ParameterError: when there is none.
    """
    if name not in METHODS:
        raise ParameterError(f"no method is called {name!r}; there are {', '.join(METHODS)}")
    return METHODS[name]


__all__ = ["METHODS", "BruteForce", "Gathered", "Method", "find_method"]
