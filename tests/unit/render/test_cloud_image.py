"""Equations 3, 4 and 9 of Dobashi et al. 2012, one pixel by hand."""

import pytest
import torch

from render.cloud_image import Lighting, blend_air, compose_cloud
from render.scattering_stack import CloudLayers

LAYERS = CloudLayers(
    single=torch.tensor([[0.2, 0.1]]),
    multiple=torch.tensor([[0.3, 0.0]]),
    transmittance=torch.tensor([[0.25, 1.0]]),
    opacity=torch.tensor([[0.75, 0.0]]),
)
SKY = torch.tensor([[0.1, 0.4], [0.2, 0.5], [0.4, 0.6]])
LIGHTING = Lighting(
    sunlight_intensity=torch.tensor([2.0]),
    sunlight_colour=torch.tensor([1.0, 0.9, 0.5]),
    ambient=torch.tensor([0.8]),
    ambient_colour=torch.tensor([0.5, 0.6, 1.0]),
)


def test_a_pixel_by_hand() -> None:
    cloud = compose_cloud(LAYERS, LIGHTING, SKY)
    assert cloud.shape == (1, 3, 2)
    # c_in L_in (single + multiple) + c_amb ambient (1 - T) + T L_sky
    expected = [1.0 * 1.0 + 0.5 * 0.6 + 0.025, 0.9 * 1.0 + 0.6 * 0.6 + 0.05, 0.5 * 1.0 + 1.0 * 0.6 + 0.1]
    assert cloud[0, :, 0].tolist() == pytest.approx(expected)
    assert cloud[0, :, 1].tolist() == pytest.approx([0.2 + 0.4, 0.18 + 0.5, 0.1 + 0.6])


@pytest.mark.parametrize(
    ("layer", "factor"), [("single", 2.0), ("multiple", 2.0), ("transmittance", 0.5), ("opacity", 0.5)]
)
def test_every_layer_counts(layer: str, factor: float) -> None:
    changed = CloudLayers(**{**LAYERS.__dict__, layer: getattr(LAYERS, layer) * factor})
    assert not torch.allclose(
        compose_cloud(changed, LIGHTING, SKY)[..., 0], compose_cloud(LAYERS, LIGHTING, SKY)[..., 0]
    )


def population() -> tuple[CloudLayers, Lighting]:
    layers = CloudLayers(*(torch.cat([layer, 0.5 * layer]) for layer in LAYERS.__dict__.values()))
    colour = torch.tensor([[0.5, 0.6, 1.0], [1.0, 0.2, 0.1]])
    return layers, Lighting(torch.tensor([2.0, 3.0]), LIGHTING.sunlight_colour, torch.tensor([0.8, 0.1]), colour)


def test_candidates_do_not_mix() -> None:
    layers, lighting = population()
    together = compose_cloud(layers, lighting, SKY)
    torch.testing.assert_close(together[:1], compose_cloud(LAYERS, LIGHTING, SKY))
    own = Lighting(torch.tensor([3.0]), LIGHTING.sunlight_colour, torch.tensor([0.1]), torch.tensor([1.0, 0.2, 0.1]))
    second = CloudLayers(*(layer[1:] for layer in layers.__dict__.values()))
    torch.testing.assert_close(together[1:], compose_cloud(second, own, SKY))


def test_air_by_hand() -> None:
    cloud = torch.tensor([[[1.0], [2.0], [3.0]]])
    sky = torch.tensor([[0.0], [1.0], [5.0]])
    depth = torch.tensor([[0.0, 0.6931472, 1.3862944]])  # 0, ln 2, ln 4
    assert blend_air(cloud, sky, depth).flatten().tolist() == pytest.approx([1.0, 1.5, 0.25 * 3.0 + 0.75 * 5.0])


def test_no_air_is_the_cloud_and_endless_air_the_sky() -> None:
    cloud = compose_cloud(*population(), SKY)
    assert torch.equal(blend_air(cloud, SKY, torch.zeros(2, 3)), cloud)
    assert torch.equal(blend_air(cloud, SKY, torch.full((2, 3), 1e4)), SKY.expand(2, 3, 2))
    assert not torch.allclose(blend_air(cloud, SKY, torch.full((2, 3), 1.0)), SKY.expand(2, 3, 2), atol=0.05)


def test_gradients_reach_all_that_is_searched() -> None:
    searched = [torch.tensor([v], requires_grad=True) for v in (2.0, 0.8)]
    depth = torch.full((1, 3), 0.3, requires_grad=True)
    lighting = Lighting(searched[0], LIGHTING.sunlight_colour, searched[1], LIGHTING.ambient_colour)
    blend_air(compose_cloud(LAYERS, lighting, SKY), SKY, depth).sum().backward()
    assert all(float(p.grad.abs().min()) > 0.0 for p in (*searched, depth) if p.grad is not None)
    assert all(p.grad is not None for p in (*searched, depth))
