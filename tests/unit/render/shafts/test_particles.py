import math

import pytest
import torch

from render.errors import ParameterError
from render.shafts.fog_bank import FogBank
from render.shafts.particles import PHASE_FUNCTIONS, check_colour, check_particles
from tests.unit.render.shafts.test_air import BLOCK


@pytest.mark.parametrize("name", PHASE_FUNCTIONS)
def test_phase_functions_integrate_to_one(name: str) -> None:
    part = FogBank(BLOCK, 1.0, phase=name, asymmetry=0.6)
    check_particles(part)
    cosine = (torch.arange(20000, dtype=torch.float64) + 0.5) / 10000 - 1.0
    total = 2.0 * math.pi * part.evaluate_phase(cosine).mean() * 2.0
    assert float(total) == pytest.approx(1.0, abs=1e-6)
    assert float((part.evaluate_phase(cosine) * cosine).mean()) != pytest.approx(0.3 / (4.0 * math.pi), abs=1e-3)


def test_colours_have_three_numbers_of_at_least_nothing() -> None:
    check_colour("fog", (0.0, 1.0, 7.0))
    for wrong in ((1.0, -0.1, 1.0), (1.0, math.nan, 1.0), (1.0, 1.0)):
        with pytest.raises(ParameterError, match="fog: expected three"):
            check_colour("fog", wrong)  # type: ignore[arg-type]
