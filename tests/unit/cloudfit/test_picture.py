import pytest
import torch

from cloudfit.picture import CandidateRendering, render_picture
from precompute.error_budget import Effort
from tests.support.small_scene import small_scene

PARAMETERS = {"sunlight_intensity": 8.0, "asymmetry": 0.5, "extinction": 0.1, "albedo": 0.95, "ambient": 0.3}
WHITE = torch.ones(3)
EFFORT = Effort(3, 800, 8_000, 4)


def test_the_layers_sum_to_the_image_and_the_sky_alone_is_left_beside_the_cloud() -> None:
    scene = small_scene()
    sky = torch.tensor([0.1, 0.25, 0.6]).expand(20, 30, 3).clone()
    picture = render_picture(scene, PARAMETERS, (0.0, 0.3, 0.6), WHITE, WHITE, sky, EFFORT)
    total = picture.single + picture.multiple + picture.ambient + picture.sky
    assert picture.rgb.shape == (scene.camera.height, scene.camera.width, 3)
    assert torch.allclose(picture.rgb, total, atol=1e-6)
    clear = picture.transmittance == 1.0
    assert 0.1 < float(clear.float().mean()) < 0.9
    assert torch.allclose(picture.rgb[clear], sky[0, 0].expand_as(picture.rgb[clear]), atol=1e-5)
    assert float(picture.transmittance.min()) < 0.01


def test_thick_air_hides_the_cloud() -> None:
    sky = torch.tensor([0.1, 0.25, 0.6]).expand(36, 48, 3).clone()
    hidden = render_picture(small_scene(), PARAMETERS, (1e4, 1e4, 1e4), WHITE, WHITE, sky, EFFORT)
    assert torch.allclose(hidden.rgb, sky, atol=1e-6)
    clear = render_picture(small_scene(), PARAMETERS, (0.0, 0.0, 0.0), WHITE, WHITE, sky, EFFORT)
    assert float((clear.rgb - sky).abs().max()) > 0.1


def test_the_search_of_the_air_recovers_the_air_of_a_picture() -> None:
    from cloudfit.colour_histogram import colour_histogram
    from cloudfit.fit_problem import visible_share

    rendering = CandidateRendering(small_scene(), PARAMETERS, EFFORT)
    sky = torch.tensor([0.1, 0.25, 0.6]).expand(36, 48, 3).clone()
    lighting = rendering.lighting(WHITE, WHITE)
    picture = rendering.picture(lighting, sky, torch.tensor([0.6, 0.4, 0.0]))
    counted = rendering.pixel[visible_share(rendering.optical_length)]
    target = colour_histogram(picture.rgb.flatten(0, 1)[counted], "srgb")
    found = rendering.search_air(lighting, sky, target, "srgb")
    assert found.air_depth[0].tolist() == pytest.approx([0.6, 0.4, 0.0])
    assert float(found.loss.max()) < 0.05
    coarse = rendering.search_air(lighting, sky, target, "srgb", 0)
    assert coarse.air_depth[0].tolist() == pytest.approx([0.6, 0.3, 0.0])
    assert float(coarse.loss[0, 1]) > 0.05
