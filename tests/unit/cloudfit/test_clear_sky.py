import numpy as np
import pytest

from cloudfit.clear_sky import find_clouds


def sky(height: int = 200, width: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Blue gradient, and where two round clouds of it would be."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    fall = (y / height)[..., None]
    blue = (np.array([0.2, 0.4, 0.8]) * (1 - fall) + np.array([0.5, 0.65, 0.85]) * fall).astype(np.float32)
    cloud = ((y - 70) ** 2 + (x - 90) ** 2 < 40**2) | ((y - 120) ** 2 + (x - 210) ** 2 < 35**2)
    return blue, cloud


def glow(height: int = 200, width: int = 300) -> np.ndarray:
    """Sunset: dark blue on top, orange at the horizon, brightest around a low sun."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    fall = (y / height)[..., None]
    colour = np.array([0.1, 0.2, 0.45]) * (1 - fall) + np.array([0.95, 0.6, 0.25]) * fall
    return (colour * (0.4 + 0.6 * np.exp(-(((x - 150) / 200) ** 2)))[..., None]).astype(np.float32)


def everywhere(display: np.ndarray) -> np.ndarray:
    return np.ones(display.shape[:2], bool)


def agreement(found: np.ndarray, cloud: np.ndarray) -> float:
    return float(found[cloud].mean() + (~found)[~cloud].mean()) / 2.0


@pytest.mark.parametrize("tint", [(1.0, 1.0, 1.0), (0.8, 1.0, 1.05), (1.05, 0.95, 1.0)])
def test_white_clouds_before_blue(tint):
    display, cloud = sky()
    display[cloud] = 0.9
    display = (display * np.array(tint, np.float32)).clip(0, 1)
    assert agreement(find_clouds(display, everywhere(display)), cloud) > 0.97


def test_shaded_clouds_before_blue():
    display, cloud = sky()
    display[cloud] = (0.35, 0.36, 0.38)
    assert agreement(find_clouds(display, everywhere(display)), cloud) > 0.97


def test_dark_clouds_before_a_glow():
    display = glow()
    _, cloud = sky()
    display[cloud] *= 0.5
    assert agreement(find_clouds(display, everywhere(display)), cloud) > 0.95
    # The glow itself, white where blue turns to orange, is no cloud.
    assert find_clouds(glow(), everywhere(display)).mean() < 0.01


def test_clear_sky_has_no_clouds_down_to_a_pale_horizon():
    display, _ = sky()
    assert find_clouds(display, everywhere(display)).mean() < 0.01


def test_grey_is_overcast_and_so_is_rough_blue_grey_without_an_edge():
    grey = np.full((120, 160, 3), 0.6, np.float32)
    assert find_clouds(grey, everywhere(grey)).all()
    y, x = np.mgrid[0:200, 0:300].astype(np.float32)
    waves = 0.45 + 0.2 * np.sin(x / 9.0) * np.sin(y / 7.0) + 0.1 * np.sin(x / 4.0 + y / 5.0)
    cool = waves[..., None] * np.array([0.82, 0.9, 1.0], np.float32)
    assert find_clouds(cool, everywhere(cool)).all()


def test_clouds_are_found_within_the_sky_alone():
    display, cloud = sky()
    display[cloud] = 0.9
    in_sky = everywhere(display)
    in_sky[:, :150] = False
    found = find_clouds(display, in_sky)
    assert not found[:, :150].any()
    assert agreement(found[:, 150:], cloud[:, 150:]) > 0.97


def test_black_is_no_cloud():
    black = np.zeros((30, 40, 3), np.float32)
    assert not find_clouds(black, everywhere(black)).any()


def test_no_sky_no_clouds():
    display, _ = sky()
    assert not find_clouds(display, np.zeros(display.shape[:2], bool)).any()


def test_specks_are_dropped_and_holes_are_filled():
    display, cloud = sky(400, 600)
    display[cloud] = 0.9
    display[300:302, 500:502] = 0.9
    found = find_clouds(display, everywhere(display))
    assert not found[295:307, 495:507].any()
    assert found[70, 90]
