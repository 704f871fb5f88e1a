import torch

from render.shafts.methods import marching
from render.shafts.rays import uniform_edges
from tests.support.shaft_scenes import small_stage


def test_chunks_do_not_show() -> None:
    stage = small_stage()
    whole = marching.march_rays(stage.scene.air, stage.lighting, stage.rays, lambda rays: uniform_edges(rays, 8), 8)
    parts = torch.cat(
        [
            marching.march_rays(stage.scene.air, stage.lighting, rays, lambda part: uniform_edges(part, 8), 8)
            for rays in (stage.rays[:100], stage.rays[100:])
        ]
    )
    torch.testing.assert_close(whole, parts)
    none = marching.march_rays(stage.scene.air, stage.lighting, stage.rays[:0], lambda rays: uniform_edges(rays, 8), 8)
    assert none.shape == (0, 3)
