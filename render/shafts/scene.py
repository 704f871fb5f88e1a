"""A scene: camera, things, air, sun and lamps."""

import math
from dataclasses import dataclass, field, replace

from render.camera import OrthographicCamera, PinholeCamera
from render.errors import SceneError
from render.shafts.air import Air
from render.shafts.lights import PointLight, Sun
from render.shafts.mesh import Mesh
from render.shafts.particles import Colour, check_colour


@dataclass(frozen=True)
class ShaftScene:
    """What is to be rendered.

    Args:
        camera: the view.
        meshes: surfaces, which also cast shadows; none is an empty scene.
        air: what scatters the light: layers, and banks of fog.
        sun: or None.
        lights: point lights.
        ambient: radiance of light that comes alike from everywhere and reaches every point undimmed; it stands for the sky
            and for light scattered more than once.
        sky: radiance behind everything, or None for a clear sky around the sun.
        reach: length of the rays that meet nothing [m]; the air beyond belongs to the sky.

    Raises:
        SceneError: for a reach that is not positive and finite, light that is negative, or a camera that cannot be finite.
    """

    camera: PinholeCamera | OrthographicCamera
    meshes: tuple[Mesh, ...] = ()
    air: Air = field(default_factory=Air)
    sun: Sun | None = None
    lights: tuple[PointLight, ...] = ()
    ambient: Colour = (0.0, 0.0, 0.0)
    sky: Colour | None = None
    reach: float = 1000.0

    def __post_init__(self) -> None:
        check_colour("ambient light", self.ambient)
        if self.sky is not None:
            check_colour("radiance of the sky", self.sky)
        if not 0.0 < self.reach < math.inf:
            raise SceneError(f"expected a positive and finite reach of the rays, got {self.reach} m")

    def at_time(self, time: float) -> "ShaftScene":
        """The same scene with its banks of fog at another time [s]."""
        return replace(self, air=self.air.at_time(time))

    def resized(self, width: int, height: int) -> "ShaftScene":
        """The same scene with other pixel counts."""
        return replace(self, camera=self.camera.resized(width, height))
