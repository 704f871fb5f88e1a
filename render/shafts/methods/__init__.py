"""The methods by name; each takes a scene that is ready and gives its in-scattered light."""

from collections.abc import Mapping
from types import MappingProxyType

from render.errors import ParameterError
from render.shafts.methods.adaptive import Adaptive
from render.shafts.methods.ali2017 import Ali2017
from render.shafts.methods.auto import Auto
from render.shafts.methods.base import Gathered, Method
from render.shafts.methods.biri2006 import Biri2006
from render.shafts.methods.brute_force import BruteForce
from render.shafts.methods.chen2011 import Chen2011
from render.shafts.methods.engelhardt2010 import Engelhardt2010
from render.shafts.methods.froxels import Froxels
from render.shafts.methods.wyman2013 import Wyman2013

METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "auto": Auto(),
        "brute_force": BruteForce(),
        "engelhardt2010": Engelhardt2010(),
        "chen2011": Chen2011(),
        "ali2017": Ali2017(),
        "interleaved": Ali2017(pattern=4),
        "biri2006": Biri2006(),
        "wyman2013": Wyman2013(),
        "adaptive": Adaptive(),
        "tan2020_froxels": Froxels(),
    }
)
"""Every method with its usual settings."""


def find_method(name: str) -> Method:
    """The method of that name.

    Raises:
        ParameterError: when there is none.
    """
    if name not in METHODS:
        raise ParameterError(f"no method is called {name!r}; there are {', '.join(METHODS)}")
    return METHODS[name]


__all__ = [
    "METHODS",
    "Adaptive",
    "Ali2017",
    "Auto",
    "Biri2006",
    "BruteForce",
    "Chen2011",
    "Engelhardt2010",
    "Froxels",
    "Gathered",
    "Method",
    "Wyman2013",
    "find_method",
]
