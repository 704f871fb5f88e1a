"""Images that are too faint to matter do not bend those beside them."""

import dataclasses

import pytest
import torch

from render.scattering_stack import ScatteringStack
from tests.unit.render.test_scattering_stack import ASYMMETRY, EXTINCTION, compose, knotted


def test_images_too_faint_for_a_float_go_on_as_the_next_ones_do() -> None:
    """Their floor, over a power of the extinction, drew the images beside them up a hundredfold."""
    tables = knotted()
    faint = tables.multiple.clone()
    faint[-1, :, :-2] = 0.0
    found, expected = (
        compose(ScatteringStack(dataclasses.replace(tables, multiple=multiple)), 0.3, float(EXTINCTION[-2]) * 1.3, 1.0)
        for multiple in (faint, tables.multiple)
    )
    torch.testing.assert_close(found.multiple, expected.multiple, rtol=0.25, atol=0.0)
    thin = compose(ScatteringStack(dataclasses.replace(tables, multiple=faint)), 0.3, float(EXTINCTION[0]), 1.0)
    assert torch.isfinite(thin.multiple).all()


@pytest.mark.parametrize("shape", [1e-38, 1e-25])
def test_images_that_are_nothing_here_and_there_do_not_shine_between(shape: float) -> None:
    """Logarithms of noise differ by tens from asymmetry to asymmetry; a cubic through them made light of it."""
    tables = knotted()
    noisy = tables.multiple.clone()
    noisy[-1] = 0.0
    noisy[-1, ::2] = shape
    dark = tables.multiple.clone()
    dark[-1] = 0.0
    asymmetry = torch.linspace(float(ASYMMETRY[0]), float(ASYMMETRY[-1]), 23)
    for extinction in (1.3, 0.7):
        point = torch.full((23,), float(EXTINCTION[1]) * extinction)
        found, expected = (
            ScatteringStack(dataclasses.replace(tables, multiple=multiple))(asymmetry, point, torch.ones(23)).multiple
            for multiple in (noisy, dark)
        )
        torch.testing.assert_close(found, expected, rtol=1e-3, atol=0.0)
