import math

import pytest

from cloudfit.fit_types import AIR_DEPTHS, AIR_REFINEMENTS, FitOptions
from cloudfit.optimisers import DEFAULT_OPTIMISER, OPTIMISERS
from cloudfit.quality import QUALITIES


def test_the_air_is_searched_in_eleven_steps_from_none_to_almost_all() -> None:
    assert len(AIR_DEPTHS) == 11
    assert AIR_DEPTHS[0] == 0.0
    assert AIR_DEPTHS[-1] == pytest.approx(3.0)
    assert math.exp(-AIR_DEPTHS[-1]) < 0.05


def test_the_defaults_name_things_that_exist() -> None:
    options = FitOptions()
    assert options.optimiser == DEFAULT_OPTIMISER in OPTIMISERS
    assert options.quality in QUALITIES.values()
    assert options.searches >= 1
    assert options.air_refinements == AIR_REFINEMENTS >= 0
