import math
from pathlib import Path

import pytest

from render.errors import SceneError
from render.media import ExponentialDecay
from render.shafts.scene import ShaftScene
from render.shafts.scene_file import PRESETS, load_scene, make_sun, parse_scene

HEAD = "camera = {position_m = [0, 0, 1], target_m = [0, 1, 1]}\n"


BANK = """[[bank]]
middle_m = [0, 10, 2]
spread_m = [4, 4, 1]
count = 5
radius_m = 3
extinction_per_m = 0.2
"""


def parse(text: str, folder: Path = Path()) -> ShaftScene:
    return parse_scene(HEAD + text, "mine.toml", folder)


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_a_scene(name: str) -> None:
    scene = load_scene(name)
    assert scene.meshes
    assert not scene.air.empty
    assert scene.sun is not None or scene.lights


def test_the_presets_are_six() -> None:
    assert PRESETS == ("columns", "fogbank", "lamps_in_fog", "lights", "ridge", "window")


def test_a_scene_is_what_the_file_says(tmp_path: Path) -> None:
    (tmp_path / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    text = """
[sun]
azimuth_deg = 90
elevation_deg = 30
colour = [1, 0.5, 0.25]
intensity = 2
[[air]]
profile = "exponential"
extinction_per_m = 0.01
scale_height_m = 50
colour = [1, 2, 3]
[[light]]
position_m = [1, 2, 3]
intensity = [4, 5, 6]
[[mesh]]
file = "t.obj"
scale = 2
offset_m = [0, 0, 7]
"""
    path = tmp_path / "mine.toml"
    path.write_text(HEAD + text)
    scene = load_scene(path)
    assert scene.sun is not None
    assert scene.sun.direction == pytest.approx((math.cos(math.radians(30.0)), 0.0, 0.5), abs=1e-12)
    assert scene.sun.irradiance == pytest.approx((2.0 * math.pi, math.pi, 0.5 * math.pi))
    assert isinstance(scene.air.constituents[0].medium, ExponentialDecay)
    assert scene.air.constituents[0].colour == (1.0, 2.0, 3.0)
    assert scene.lights[0].intensity == (4.0, 5.0, 6.0)
    assert [0.0, 0.0, 9.0] in scene.meshes[0].vertices.tolist()


def test_a_bank_of_fog_is_at_the_time_of_the_scene() -> None:
    more = "wind_m_per_s = [1, 0, 0]\nchange_time_s = 60\nasymmetry = 0.5\nresolution = 32\nshadow = false\nseed = 4\n"
    bank = parse("time_s = 12\n" + BANK + more).air.banks[0]
    assert (bank.extinction, bank.asymmetry, bank.resolution, bank.shadow, bank.time) == (0.2, 0.5, 32, False, 12.0)
    assert (bank.medium.wind, bank.medium.change_time, bank.medium.seed) == ((1.0, 0.0, 0.0), 60.0, 4)
    assert bank.medium.noise_wavelength == 3.0
    assert parse(BANK).air.banks[0].time == 0.0
    assert not parse(BANK).air.empty


def test_a_low_sun_is_red() -> None:
    low, high = make_sun(0.0, math.radians(3.0)).irradiance, make_sun(0.0, math.radians(60.0)).irradiance
    assert low[0] / low[2] > 2.0 > high[0] / high[2]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[sun]\nazimuth_deg = 1\n", "elevation_deg is missing"),
        ("[sun]\nazimuth_deg = 1\nelevation_deg = 2\ncolor = 3\n", "unknown key 'color'"),
        ("[[air]]\nextinction_per_m = 1\n", "top_m is missing"),
        ("[[air]]\nprofile = 'thick'\n", "no profile is called 'thick'"),
        ("[[air]]\ntop_m = 3\n", "either visibility_m or extinction_per_m"),
        ("[[air]]\ntop_m = 3\nextinction_per_m = -1\n", "finite extinction"),
        ("[[sphere]]\ncentre_m = [0, 0, 0]\nradius_m = 0\n", "positive radius"),
        ("[[mesh]]\nfile = 'gone.obj'\n", "no such file"),
        ("[[tree]]\n", "unknown key 'tree'"),
        ("[[bank]]\n", "middle_m is missing"),
        (BANK + "fluff = 3\n", "unknown key 'fluff'"),
        (BANK + "visibility_m = 3\n", "either visibility_m or extinction_per_m"),
        (BANK + "strength = -1\n", "finite strength of at least 0 of a bank"),
        (BANK.replace("count = 5", "count = 0"), "fills no box"),
        (BANK + "scale_height_m = 5\n", "needs a base"),
        ("reach_m = [", "not a TOML file"),
    ],
)
def test_bad_input_names_the_file_and_the_reason(text: str, words: str) -> None:
    with pytest.raises(SceneError, match=r"mine\.toml|gone\.obj|sphere") as caught:
        parse(text)
    assert words in str(caught.value)


def test_a_scene_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="there are the presets columns, fogbank, lamps_in_fog, lights, ridge, window"):
        load_scene("sahara")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SceneError, match="not a text file"):
        load_scene(tmp_path / "bytes.toml")
