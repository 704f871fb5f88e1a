"""Random scenes of light shafts, the same for the same seed: what stands there, where the sun is, how many lamps, and what the air is."""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import torch

from render.camera import PinholeCamera, direction_from_angles
from render.media import ExponentialDecay, LayeredMedium, LinearDecay, Uniform
from render.random_streams import child_generator
from render.shafts.air import Air, Constituent
from render.shafts.casters import make_columns, make_ground, make_ridge, make_sphere, make_window
from render.shafts.lights import PointLight, Sun
from render.shafts.mesh import Mesh, place_mesh
from render.shafts.scene import ShaftScene

SCENES = 10
"""Of which nine have to keep within a tolerance."""


class Dice:
    """Random numbers of one scene."""

    def __init__(self, seed: int, number: int) -> None:
        self._generator = child_generator(seed, number)

    def between(self, lowest: float, highest: float) -> float:
        """Uniform in an interval."""
        return lowest + (highest - lowest) * float(torch.rand((), generator=self._generator))

    def magnitude(self, lowest: float, highest: float) -> float:
        """Log-uniform between positive numbers."""
        return math.exp(self.between(math.log(lowest), math.log(highest)))

    def whole(self, lowest: int, highest: int) -> int:
        """A whole number, ends included."""
        return int(torch.randint(lowest, highest + 1, (), generator=self._generator))


def _ridge(dice: Dice, size: float) -> list[Mesh]:
    mountains = make_ridge(
        5.0 * size, 1.8 * size, dice.between(1.0, 1.8) * size, 160, dice.whole(3, 8), dice.whole(0, 999)
    )
    return [place_mesh(mountains, offset=(0.0, dice.between(0.0, 0.5) * size, 0.0))]


def _columns(dice: Dice, size: float) -> list[Mesh]:
    count, height = dice.whole(3, 8), dice.between(0.7, 1.2) * size
    rows = make_columns(count, 2.2 * size / count, dice.between(0.05, 0.12) * size, height)
    return [place_mesh(rows, turn=dice.between(-0.6, 0.6), offset=(0.0, 0.0, 0.0))]


def _window(dice: Dice, size: float) -> list[Mesh]:
    panes = (dice.whole(1, 5), dice.whole(1, 4))
    wall = (1.2 * size, 0.1 * size, 0.5 * size)
    width, height = dice.between(0.5, 1.0) * size, dice.between(0.4, 0.7) * size
    return [make_window(width, height, panes, 0.03 * size, wall, 0.1 * size)]


def _spheres(dice: Dice, size: float) -> list[Mesh]:
    balls = []
    for _ in range(dice.whole(3, 9)):
        radius = dice.between(0.1, 0.35) * size
        place = (dice.between(-0.9, 0.9) * size, dice.between(-0.6, 0.8) * size, radius + dice.between(0.0, 0.4) * size)
        balls.append(make_sphere(place, radius, 48))
    return balls


CASTERS: Mapping[str, Callable[[Dice, float], list[Mesh]]] = MappingProxyType(
    {"ridge": _ridge, "columns": _columns, "window": _window, "spheres": _spheres}
)
"""What may stand in a scene of a size [m], in turns."""

SUNS: Mapping[str, tuple[tuple[float, float], tuple[float, float]]] = MappingProxyType(
    {
        "in frame": ((-12.0, 12.0), (3.0, 16.0)),
        "out of frame": ((50.0, 110.0), (6.0, 35.0)),
        "behind": ((150.0, 210.0), (6.0, 35.0)),
    }
)
"""Where the sun may be, in turns: azimuth from the view and elevation [degree]."""


def draw_scene(number: int, seed: int = 0, width: int = 320, height: int = 180) -> tuple[str, ShaftScene]:
    """A random scene.

    Args:
        number: of the scene; casters and places of the sun take turns with it, every third scene has lamps as well.
        seed: of all scenes.
        width, height: of the picture [pixel].

    Returns:
        A few words about it, and the scene.
    """
    dice = Dice(seed, number)
    caster = list(CASTERS)[number % len(CASTERS)]
    where = list(SUNS)[number % len(SUNS)]
    size = dice.magnitude(300.0, 3000.0) if caster == "ridge" else dice.magnitude(3.0, 30.0)
    eye = (dice.between(-0.4, 0.4) * size, -dice.between(1.8, 2.6) * size, dice.between(0.12, 0.5) * size)
    target = (dice.between(-0.2, 0.2) * size, 0.0, dice.between(0.25, 0.45) * size)
    heading = math.atan2(target[0] - eye[0], target[1] - eye[1])
    azimuths, elevations = SUNS[where]
    azimuth, elevation = (math.radians(dice.between(*ends)) for ends in (azimuths, elevations))
    meshes = (*CASTERS[caster](dice, size), make_ground(40.0 * size))
    lamps = tuple(_draw_lamp(dice, size) for _ in range(dice.whole(1, 4) if number % 3 == 1 else 0))
    scene = ShaftScene(
        camera=PinholeCamera(eye, target, dice.between(0.6, 1.1), width, height),
        meshes=meshes,
        air=_draw_air(dice, size),
        sun=Sun(direction_from_angles(heading + azimuth, elevation), (3.0, 2.8, 2.4)),
        lights=lamps,
        sky=(0.3, 0.4, 0.6),
        reach=8.0 * size,
    )
    return f"{caster}, sun {where}, {len(lamps)} lamps", scene


def _draw_lamp(dice: Dice, size: float) -> PointLight:
    """A lamp about as bright as the sun at a third of the scene's size."""
    place = (dice.between(-0.8, 0.8) * size, dice.between(-0.8, 0.6) * size, dice.between(0.1, 0.5) * size)
    power = dice.between(0.2, 1.0) * (0.35 * size) ** 2
    return PointLight(place, (3.0 * power, 2.5 * power, 1.5 * power), 0.01 * size)


def _draw_air(dice: Dice, size: float) -> Air:
    """One or two layers, of an optical depth from thin haze to fog across the scene."""
    extinction = dice.magnitude(0.03, 0.6) / size
    profile = _PROFILES[dice.whole(0, len(_PROFILES) - 1)](dice, size, extinction)
    haze = Constituent(profile, albedo=dice.between(0.8, 1.0), asymmetry=dice.between(0.0, 0.8))
    molecules = Constituent(ExponentialDecay(0.02 / size, 3.0 * size), (0.4, 0.9, 2.0), phase="rayleigh")
    return Air((haze, molecules) if dice.whole(0, 1) else (haze,))


_PROFILES: tuple[Callable[[Dice, float, float], LayeredMedium], ...] = (
    lambda dice, size, extinction: Uniform(extinction, dice.between(1.0, 3.0) * size, -math.inf),
    lambda dice, size, extinction: LinearDecay(extinction, dice.between(1.0, 3.0) * size, 0.0),
    lambda dice, size, extinction: ExponentialDecay(extinction, dice.between(0.2, 2.0) * size, 0.0),
)
