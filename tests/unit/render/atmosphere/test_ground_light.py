"""Light on the ground against the exact integral and closed forms."""

import math

import torch

from render.atmosphere.ground_light import (
    look_up_ground_irradiance,
    look_up_ground_radiance,
    look_up_ground_sunlight,
)
from render.atmosphere.shells import compute_exact_direct_irradiance
from tests.support.skies import coarse_source

SOURCE = coarse_source()
COSINES = torch.tensor([1.0, 0.7, 0.2, 0.02, 0.0, -0.001, -0.2], dtype=torch.float64)


def test_sunlight_is_the_exact_one() -> None:
    found = look_up_ground_sunlight(SOURCE.shells, SOURCE.sun_columns, COSINES)
    exact = compute_exact_direct_irradiance(SOURCE.shells, COSINES)
    torch.testing.assert_close(found[:4], exact[:4], rtol=2e-3, atol=0.0)
    assert float(found[-1].abs().max()) == 0.0
    assert bool((found[4:6] > 0.0).all()), "half of the disc is above the horizon, and then a part"
    assert not torch.allclose(found[1], exact[1] / 0.7, rtol=0.1)


def test_the_ground_reflects_its_albedo() -> None:
    lit = look_up_ground_irradiance(SOURCE, COSINES)
    assert bool((lit.sky[:4] > 0.0).all())
    sent = look_up_ground_radiance(SOURCE, COSINES)
    torch.testing.assert_close(sent, 0.1 / math.pi * (lit.sun + lit.sky))
    assert not torch.allclose(sent, 0.1 * (lit.sun + lit.sky))
