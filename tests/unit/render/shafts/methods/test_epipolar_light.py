from dataclasses import replace

import torch
from torch import Tensor

from render.camera import OrthographicCamera
from render.shafts.epipolar_sampling import EpipolarSettings
from render.shafts.lights import Lighting
from render.shafts.methods.epipolar_light import MOST_RAYS, describe, find_light_image, gather_along_lines
from render.shafts.rays import ViewRays
from render.shafts.stage import Clock
from tests.support.shaft_scenes import small_scene, small_stage


def test_the_light_is_seen_where_its_ray_goes() -> None:
    stage = small_stage()
    sun, lamp = (find_light_image(stage, light) for light in stage.lighting.separate())
    assert sun is not None
    assert lamp is not None
    for image, target in ((sun, stage.scene.sun), (lamp, stage.scene.lights[0])):
        point = torch.tensor([[image.x / image.w, image.y / image.w]])
        ray = stage.rays_through(point, torch.ones(1)).direction[0]
        place = getattr(target, "direction", None) or tuple(
            a - b for a, b in zip(stage.scene.lights[0].position, stage.scene.camera.position, strict=True)
        )
        torch.testing.assert_close(ray, torch.nn.functional.normalize(torch.tensor(place), dim=0), atol=1e-5, rtol=0.0)


def test_lights_are_gathered_one_by_one_and_added() -> None:
    stage, seen = small_stage(), []

    def marcher(lighting: Lighting, rays: ViewRays, line: Tensor | None) -> Tensor:
        seen.append((lighting.names, line is None))
        return torch.full((len(rays), 3), 1.0 if lighting.sun is not None else 10.0)

    light = gather_along_lines(stage, stage.lighting, EpipolarSettings(), marcher, Clock())
    torch.testing.assert_close(light, torch.full_like(light, 11.0))
    assert ("the sun", False) in seen
    assert ("one lamp", True) in seen


def test_a_sun_in_line_with_parallel_rays_has_no_lines() -> None:
    scene = small_scene()
    assert scene.sun is not None
    x, y, z = scene.sun.direction
    camera = OrthographicCamera((-60.0 * x, -60.0 * y, -60.0 * z), (0.0, 0.0, 0.0), 40.0, 12, 8)
    stage = small_stage(replace(scene, camera=camera, lights=(), meshes=scene.meshes[:1]))
    image = find_light_image(stage, stage.lighting)
    assert image is None or max(abs(image.x), abs(image.y)) > 0.0
    light = gather_along_lines(
        stage, stage.lighting, EpipolarSettings(), lambda _, rays, __: torch.ones(len(rays), 3), Clock()
    )
    torch.testing.assert_close(light, torch.ones_like(light))
    assert "16th" in describe(EpipolarSettings())


def test_lines_denser_than_pixels_give_way_to_the_pixels() -> None:
    stage = small_stage(small_scene(lamps=False))
    seen: list[tuple[int, int]] = []

    def marcher(_: Lighting, rays: ViewRays, line: Tensor | None) -> Tensor:
        seen.append((len(rays), 0 if line is None else len(line.unique())))
        return torch.ones(len(rays), 3)

    pixels = len(stage.rays)
    gather_along_lines(stage, stage.lighting, EpipolarSettings(0.2, 0.2, 1, 0.1), marcher, Clock())
    assert seen == [(pixels, pixels)]
    seen.clear()
    gather_along_lines(stage, stage.lighting, EpipolarSettings(6.0, 1.0, 8, 0.5), marcher, Clock())
    assert sum(rays for rays, _ in seen) <= MOST_RAYS * pixels
    assert len(seen) == 2
