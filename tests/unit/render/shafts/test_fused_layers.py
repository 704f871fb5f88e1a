import math

import numpy as np
import pytest
import torch

from render.fused import fused_loops_wanted
from render.media import ExponentialDecay, LinearDecay, Uniform
from render.shafts.air import Air, Constituent
from tests.support.shaft_scenes import FOG, MOLECULES

if not fused_loops_wanted():
    pytest.skip("needs numba", allow_module_level=True)

from render.shafts.fused_layers import (
    evaluate_phase,
    grey_depth,
    grey_extinction,
    layer_array,
    mean_exponential,
    moment,
)

MEDIA = (Uniform(0.01, 30.0, -5.0), LinearDecay(0.02, 40.0, -5.0), ExponentialDecay(0.01, 12.0, -5.0))


def test_moments_join_their_series() -> None:
    for x in (1e-9, 0.03, 0.0599, 0.0601, 2.0, 300.0):
        assert moment(x) == pytest.approx(-math.expm1(-x) / x, rel=1e-9)
    assert mean_exponential(1.0, 3.0) == mean_exponential(3.0, 1.0) == pytest.approx((math.exp(-1) - math.exp(-3)) / 2)
    assert mean_exponential(800.0, 900.0) == 0.0


@pytest.mark.parametrize("medium", MEDIA)
def test_depths_are_those_of_the_media(medium: Uniform) -> None:
    part = Constituent(medium)
    layers = layer_array(Air((part,)))
    for height, slope in ((3.0, 0.2), (-20.0, 0.9), (80.0, -0.6), (5.0, 0.0), (10.0, 1e-4)):
        wanted = part.compute_depth(torch.tensor(height).double(), torch.tensor(slope).double(), 50.0)[0]
        found = grey_depth(layers, 0, height, height + 50.0 * slope, 50.0)
        assert found == pytest.approx(float(wanted), rel=1e-6, abs=1e-12)
        assert wanted == 0.0 or grey_depth(layers, 0, height, height + 50.0 * slope, 51.0) > 1.01 * float(wanted)


@pytest.mark.parametrize("medium", MEDIA)
def test_extinctions_are_those_of_the_media(medium: Uniform) -> None:
    part = Constituent(medium)
    layers = layer_array(Air((part,)))
    for height in (-4.0, 3.0, 29.0):
        assert grey_extinction(layers, 0, height) == pytest.approx(
            float(part.compute_extinction(torch.tensor(height).double())[0]), rel=1e-6
        )
        thin = grey_depth(layers, 0, height, height + 1e-3, 1e-3) / 1e-3
        assert grey_extinction(layers, 0, height) == pytest.approx(thin, rel=1e-3)
    assert grey_extinction(layers, 0, -6.0) == 0.0


def test_phase_functions_are_those_of_the_particles() -> None:
    layers = layer_array(Air((FOG, MOLECULES)))
    for row, part in zip(layers, (FOG, MOLECULES), strict=True):
        for cosine in (-1.0, 0.2, 1.0):
            wanted = float(part.evaluate_phase(torch.tensor(cosine, dtype=torch.float64)))
            assert evaluate_phase(row[10], cosine) == pytest.approx(wanted, rel=1e-6)
    assert np.isnan(layers[1, 10])
    assert layers[0, 9] == 0.9
