from dataclasses import replace

import pytest
import torch

from render.fused import fused_loops_wanted, torch_loops_only
from render.media import LinearDecay
from render.shafts.air import Air, Constituent
from render.shafts.march import ShadowLooks, march
from render.shafts.rays import uniform_edges
from render.shafts.stage import Stage
from tests.support.shaft_scenes import FOG, MOLECULES, relative_rms, small_scene, small_stage

pytestmark = pytest.mark.skipif(not fused_loops_wanted(), reason="needs numba")


def both(stage: Stage, looks: ShadowLooks, spent: float = 0.0) -> tuple[torch.Tensor, torch.Tensor]:
    edges = uniform_edges(stage.rays, 24)
    fused = march(stage.scene.air, stage.lighting, stage.rays, edges, spent, looks).in_scattering
    with torch_loops_only():
        return fused, march(stage.scene.air, stage.lighting, stage.rays, edges, spent, looks).in_scattering


@pytest.mark.parametrize("looks", [ShadowLooks(), ShadowLooks(3), ShadowLooks(2, 5)])
@pytest.mark.parametrize("elevation_deg", [28.0, 4.0])
def test_the_twin_gives_what_the_torch_loop_gives(looks: ShadowLooks, elevation_deg: float) -> None:
    stage = small_stage(small_scene(sun_elevation_deg=elevation_deg))
    fused, plain = both(stage, looks)
    # A place on the border of a texel may round to either side.
    assert relative_rms(fused, plain) < 1e-4
    assert ((fused - plain).abs() < 1e-5 * plain.max()).float().mean() > 0.99
    other = replace(stage, lighting=replace(stage.lighting, points=()))
    assert relative_rms(both(other, looks)[0], plain) > 1e-2


@pytest.mark.parametrize(
    "air", [Air((FOG,)), Air((Constituent(LinearDecay(0.02, 40.0, -50.0)),)), Air((MOLECULES,)), Air()]
)
def test_every_profile_grey_or_coloured(air: Air) -> None:
    fused, plain = both(small_stage(small_scene(air=air)), ShadowLooks())
    torch.testing.assert_close(fused, plain, rtol=1e-4, atol=1e-5 * max(float(plain.max()), 1e-9))


def test_a_set_sun_and_a_lamp_with_a_reach() -> None:
    scene = small_scene(sun_elevation_deg=-8.0)
    lamp = replace(scene.lights[0], reach=25.0)
    fused, plain = both(small_stage(replace(scene, lights=(lamp, lamp))), ShadowLooks())
    assert relative_rms(fused, plain) < 1e-4
    assert float(plain.max()) > 0.0


def test_a_ray_that_is_spent_is_left() -> None:
    stage = small_stage(small_scene(lamps=False))
    whole, _ = both(stage, ShadowLooks())
    left, _ = both(stage, ShadowLooks(), spent=0.5)
    assert (left <= whole + 1e-6).all()
    assert relative_rms(left, whole) > 1e-3
    hardly, _ = both(stage, ShadowLooks(), spent=1e-6)
    torch.testing.assert_close(hardly, whole)
