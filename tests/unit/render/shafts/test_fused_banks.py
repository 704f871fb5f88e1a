from dataclasses import replace

import pytest
import torch

from render.fused import fused_loops_wanted, torch_loops_only
from render.shafts.march import ShadowLooks, march
from render.shafts.rays import uniform_edges
from render.shafts.stage import Stage
from tests.support.shaft_scenes import relative_rms, small_scene, small_stage
from tests.unit.render.shafts.test_fog_bank import BLOCK, FOG

pytestmark = pytest.mark.skipif(not fused_loops_wanted(), reason="needs numba")

COLOURED = replace(FOG, medium=replace(FOG.medium, middle=(-6.0, 2.0, 6.0), seed=8), colour=(1.0, 0.6, 0.3))
HARD = replace(FOG, medium=replace(BLOCK, lower=BLOCK.lower - 30.0, upper=BLOCK.upper - 20.0), shadow=False)


def both(stage: Stage, looks: ShadowLooks) -> tuple[torch.Tensor, torch.Tensor]:
    edges = uniform_edges(stage.rays, 48)
    fused = march(stage.scene.air, stage.lighting, stage.rays, edges, looks=looks).in_scattering
    with torch_loops_only():
        return fused, march(stage.scene.air, stage.lighting, stage.rays, edges, looks=looks).in_scattering


@pytest.mark.parametrize("banks", [(FOG,), (FOG, COLOURED), (HARD, FOG)])
@pytest.mark.parametrize("looks", [ShadowLooks(), ShadowLooks(2, 5)])
def test_the_twin_gives_what_the_torch_loop_gives(banks: tuple, looks: ShadowLooks) -> None:
    scene = small_scene()
    stage = small_stage(replace(scene, air=replace(scene.air, banks=banks)))
    fused, plain = both(stage, looks)
    # A place on the border of a texel, or of a bank, may round to either side.
    assert relative_rms(fused, plain) < 1e-4
    assert ((fused - plain).abs() < 2e-5 * plain.max()).float().mean() > 0.99
    points = tuple(replace(point, shades=()) for point in stage.lighting.points)
    bright = replace(stage, lighting=replace(stage.lighting, sun=replace(stage.lighting.sun, shades=()), points=points))
    assert relative_rms(both(bright, looks)[0], plain) > 1e-2


def test_a_bank_without_layers_and_without_a_sun() -> None:
    scene = replace(small_scene(), sun=None)
    fused, plain = both(
        small_stage(replace(scene, air=replace(scene.air, constituents=(), banks=(FOG,)))), ShadowLooks()
    )
    torch.testing.assert_close(fused, plain, rtol=1e-4, atol=1e-6)
    assert float(plain.max()) > 0.0
