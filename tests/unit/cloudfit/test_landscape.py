import numpy as np
import pytest

from cloudfit.landscape import find_sky
from render.colour import linear_to_srgb
from tests.support.sky_scenes import clear_scene, cloudy_scene


def test_sky_ends_at_the_skyline():
    pixels, _, ground = cloudy_scene()
    sky = find_sky(linear_to_srgb(pixels).numpy())
    assert sky[~ground.numpy()].mean() > 0.95
    assert sky[ground.numpy()].mean() < 0.01


def test_a_sky_without_ground_is_all_sky():
    assert find_sky(linear_to_srgb(clear_scene()).numpy()).all()


def test_ground_upside_down_is_no_ground():
    # Position counts: the same picture turned over has no skyline below its sky.
    pixels, _, ground = cloudy_scene()
    upside_down = find_sky(linear_to_srgb(pixels.flip(0)).numpy())
    assert upside_down[~ground.flip(0).numpy()].mean() > 0.9


def test_a_pond_below_the_skyline_is_not_sky():
    pixels, _, _ = cloudy_scene()
    pixels = pixels.clone()
    pixels[135:150, 60:160] = pixels[5, 5]
    sky = find_sky(linear_to_srgb(pixels).numpy())
    assert not sky[137:148, 65:155].any()


def test_a_tower_before_the_sky_is_not_sky():
    pixels, _, _ = cloudy_scene(320, 480)
    generator = np.random.default_rng(3)
    pixels = pixels.clone()
    bricks = generator.uniform(0.02, 0.2, (220, 60, 1)).astype(np.float32)
    pixels[40:260, 20:80] = pixels.new_tensor(bricks).expand(-1, -1, 3)
    sky = find_sky(linear_to_srgb(pixels).numpy())
    assert sky[60:240, 30:70].mean() < 0.1
    assert sky[:230, 120:].mean() > 0.9


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (3, 3)])
def test_tiny_pictures(size):
    assert find_sky(np.full((*size, 3), 0.5, np.float32)).shape == size
