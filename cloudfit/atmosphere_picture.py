"""A fitted cloud in an atmosphere: its sky behind, its sunlight on the cloud, its air in front."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from cloudfit.fit_types import Picture
from cloudfit.picture import AirBefore, CandidateRendering
from cloudfit.scene import Scene
from cloudfit.sky_models import SkyModel
from precompute.error_budget import Effort
from precompute.scattering_orders import Progress
from render.atmosphere.ray_geometry import distance_to_bottom_boundary, ray_intersects_ground
from render.atmosphere.spectral_colour import convert_to_linear_srgb
from render.camera import Camera, OrthographicCamera, PinholeCamera
from render.errors import ParameterError


@dataclass(frozen=True)
class CloudPlace:
    """Where viewer and cloud stand.

    Args:
        altitude: of the viewer above the ground [m].
        distance: of the cloud from the viewer [m]; None for that of the camera from its target.

    Raises:
        ParameterError: for a viewer below the ground, or a distance that is not positive.
    """

    altitude: float = 2.0
    distance: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.altitude) and self.altitude >= 0.0):
            raise ParameterError(f"the viewer must stand on the ground or above it, not at {self.altitude} m")
        if self.distance is not None and not (math.isfinite(self.distance) and self.distance > 0.0):
            raise ParameterError(f"a cloud stands at a positive distance, not {self.distance} m")

    def distance_for(self, camera: Camera) -> float:
        """The distance [m]."""
        return self.distance if self.distance is not None else float(torch.linalg.vector_norm(_axis(camera)))

    def point(self, camera: Camera, bottom_radius: float) -> Tensor:
        """The cloud from the planet's centre `(3,)` [m]. Raises ParameterError where it is below the ground."""
        forward = torch.nn.functional.normalize(_axis(camera), dim=0)
        eye = forward.new_tensor([0.0, 0.0, bottom_radius + self.altitude])
        point = eye + self.distance_for(camera) * forward
        if float(torch.linalg.vector_norm(point)) < bottom_radius:
            raise ParameterError(
                f"seen from {self.altitude:g} m, a cloud {self.distance_for(camera):g} m ahead is below the ground; raise the "
                "viewer or the camera's elevation"
            )
        return point


def _axis(camera: Camera) -> Tensor:
    """From the camera to its target `(3,)` [m]."""
    if not isinstance(camera, PinholeCamera | OrthographicCamera):
        raise ParameterError(f"expected a pinhole or an orthographic camera, got {type(camera).__name__}")
    return torch.tensor(camera.target, dtype=torch.float64) - torch.tensor(camera.position, dtype=torch.float64)


def render_in_atmosphere(
    scene: Scene,
    parameters: dict[str, float],
    model: SkyModel,
    place: CloudPlace,
    effort: Effort,
    seed: int = 0,
    on_progress: Progress = lambda stage, share: None,
) -> Picture:
    """Render fitted parameters in an atmosphere.

    Of the parameters only those of the cloud matter, asymmetry, extinction and albedo: light and air are the atmosphere's. Its light
    falls on all of the cloud as on the point in the middle of the picture, and all of the cloud is at one distance. The ground hides what
    lies behind it.

    Args:
        scene: volume, camera and sun.
        parameters: searched parameters by name, in units.
        model: of the sky.
        place: where viewer and cloud stand.
        effort: of the rendering.
        seed: of the random streams.
        on_progress: called with a stage and the share of it that is done.

    Returns:
        The picture at the camera's size, in linear sRGB [cd/m^2].

    Raises:
        ParameterError: for a cloud below the ground.
    """
    air, sky = compose_air(scene, model, place)
    return CandidateRendering(scene, parameters, effort, seed, on_progress).picture_in_air(air, sky)


def compose_air(scene: Scene, model: SkyModel, place: CloudPlace) -> tuple[AirBefore, Tensor]:
    """What the atmosphere does to a cloud and its picture, and the sky behind.

    The layers of a cloud are grey, so the spectrum of the sunlight times the transmittance of the air becomes a colour, and that colour
    times the layers the picture: nothing is lost by three channels.

    Args:
        scene: volume, camera and sun.
        model: of the sky.
        place: where viewer and cloud stand.

    Returns:
        The air and the sky, all `(height, width, channel)`, float32 [cd/m^2]; the sunlight [lx].

    Raises:
        ParameterError: for a cloud below the ground.
    """
    camera, planet = scene.camera, model.atmosphere
    sun = torch.nn.functional.normalize(scene.sun_direction.double(), dim=0)
    point = place.point(camera, planet.bottom_radius)
    radius = torch.linalg.vector_norm(point)
    up = (point @ sun / radius).clamp(-1.0, 1.0)
    there = torch.stack([(1.0 - up * up).sqrt(), torch.zeros_like(up), up])
    sunlight, ambient = model.light_at(float(radius) - planet.bottom_radius, there)
    direction = torch.nn.functional.normalize(camera.rays()[1].double(), dim=-1)
    before = model.light_up_to(place.distance_for(camera), place.altitude, direction, sun)
    sky = model.compose(place.altitude, direction, sun)

    def colour(spectrum: Tensor) -> Tensor:
        rgb = convert_to_linear_srgb(spectrum, planet.wavelengths).clamp(min=0.0)
        return rgb.reshape(camera.height, camera.width, 3).float()

    through = before.transmittance
    eye = direction.new_tensor(planet.bottom_radius + place.altitude)
    ground = distance_to_bottom_boundary(planet, eye, direction[:, 2])
    hidden = ray_intersects_ground(planet, eye, direction[:, 2]) & (ground < place.distance_for(camera))
    visible = (~hidden).reshape(camera.height, camera.width).float()
    air = AirBefore(colour(through * sunlight), colour(through * ambient), colour(before.radiance), visible)
    return air, colour(sky)
