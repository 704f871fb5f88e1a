"""Small scenes of light shafts, and a stage for each."""

import math

import torch

from render.camera import PinholeCamera, direction_from_angles
from render.media import ExponentialDecay, Uniform
from render.shafts.air import Air, Constituent
from render.shafts.casters import make_ground, make_sphere
from render.shafts.lights import PointLight, Sun
from render.shafts.mesh import Mesh
from render.shafts.scene import ShaftScene
from render.shafts.stage import MapSettings, Stage, prepare_stage

FOG = Constituent(Uniform(0.012, 60.0, -math.inf), albedo=0.9, asymmetry=0.5)
MOLECULES = Constituent(ExponentialDecay(1e-3, 90.0, -math.inf), (0.4, 0.7, 1.3), phase="rayleigh")
SMALL_MAPS = MapSettings(128, 32)


def small_scene(
    width: int = 24,
    height: int = 16,
    meshes: tuple[Mesh, ...] | None = None,
    air: Air | None = None,
    sun_elevation_deg: float = 28.0,
    lamps: bool = True,
) -> ShaftScene:
    """A sphere above ground in fog and air, lit by the sun from behind and by a lamp."""
    sun = Sun(direction_from_angles(math.radians(15.0), math.radians(sun_elevation_deg)), (3.0, 2.8, 2.4))
    things = (make_sphere((2.0, 0.0, 9.0), 5.0, 24), make_ground(300.0)) if meshes is None else meshes
    return ShaftScene(
        camera=PinholeCamera((0.0, -50.0, 6.0), (0.0, 0.0, 8.0), math.radians(45.0), width, height),
        meshes=things,
        air=Air((FOG, MOLECULES)) if air is None else air,
        sun=sun,
        lights=(PointLight((-9.0, -8.0, 5.0), (60.0, 50.0, 30.0)),) if lamps else (),
        reach=160.0,
    )


def small_stage(scene: ShaftScene | None = None, maps: MapSettings = SMALL_MAPS) -> Stage:
    """The scene made ready, with small maps."""
    return prepare_stage(small_scene() if scene is None else scene, maps)


def relative_rms(light: torch.Tensor, truth: torch.Tensor) -> float:
    """Root mean square of the difference over that of the truth."""
    return float((light - truth).double().square().mean().sqrt() / truth.double().square().mean().sqrt())
