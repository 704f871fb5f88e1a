"""A coarse source function of the Earth, built once for all tests of a process."""

import functools

from precompute.atmosphere.source_budget import build_source_function
from precompute.atmosphere.source_function import SourceSizes
from render.atmosphere.earth import earth
from render.atmosphere.source_function import SourceFunction


@functools.cache
def coarse_source() -> SourceFunction:
    """Two orders of the Earth's light in three wavelengths, within half a second."""
    return build_source_function(earth(), orders=2, sizes=SourceSizes(6, 13, 9, 5, 6, 8, 6, 8))[0]
