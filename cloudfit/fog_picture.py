"""A picture seen through fog: what stands behind the fog, the light that it scatters, and the picture of both."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.camera import Camera, PinholeCamera, direction_from_angles
from render.errors import ParameterError
from render.gradient_sky import look_up_gradient_sky
from render.media import FogLight, LayeredMedium, compose_fog
from render.media.sphere import EARTH_RADIUS
from render.plain_scene import trace_plain

SKY_SAMPLES = 24
"""Slopes and azimuths at which the light of the sky is averaged."""

DIFFUSE_SHARE = 0.5
"""Share of the sunlight on level ground that thick fog keeps within itself by scattering it more than once; by eye."""

FARTHEST_SHARE = 0.1
"""Share of a photograph's pixels, the farthest ones, whose mean colour is the light in its fog where no sky is seen."""


LOW_SUN = math.sin(math.radians(20.0))
"""Slope of the sun below which the ground counts as round; above it that changes less than 1e-3 of the light."""

CHUNK = 1 << 14
"""Rays composed at once: their numbers stay in the cache."""


@dataclass(frozen=True, eq=False)
class Backdrop:
    """What is seen without fog.

    Args:
        radiance: `(height, width, channel)` linear light [1].
        distance: along the view rays `(height, width)` [m]; infinite for the sky.
        ambient: mean radiance of the light from everywhere `(channel,)` [1].
    """

    radiance: Tensor
    distance: Tensor
    ambient: Tensor


@dataclass(frozen=True, eq=False)
class FoggyPicture:
    """The picture and its layers.

    Args:
        radiance: `(height, width, channel)` linear light [1].
        transmittance: `(height, width)` [1].
        in_scattering: light that the fog adds `(height, width, channel)` [1].
        distance: `(height, width)` [m].
    """

    radiance: Tensor
    transmittance: Tensor
    in_scattering: Tensor
    distance: Tensor

    def reduced(self, factor: int) -> "FoggyPicture":
        """The picture with blocks of so many pixels a side averaged; a distance is that of the block's first pixel."""
        return FoggyPicture(
            _average_blocks(self.radiance, factor),
            _average_blocks(self.transmittance[..., None], factor)[..., 0],
            _average_blocks(self.in_scattering, factor),
            self.distance[::factor, ::factor],
        )

    def layers(self) -> dict[str, Tensor]:
        """Layers of an EXR file by name."""
        return {
            "rgb": self.radiance,
            "scattered": self.in_scattering,
            "transmittance": self.transmittance,
            "distance": self.distance,
        }


def _average_blocks(image: Tensor, factor: int) -> Tensor:
    height, width, channels = image.shape
    return image.reshape(height // factor, factor, width // factor, factor, channels).mean((1, 3))


def aim_camera(azimuth: float, elevation: float, field_of_view: float, size: tuple[int, int]) -> PinholeCamera:
    """Camera that gives the directions of view; how high the eye is concerns the fog alone.

    Args:
        azimuth, elevation: direction of view [rad].
        field_of_view: vertical opening angle [rad].
        size: width and height [pixel].

    Returns:
        The camera.

    Raises:
        CameraError: where the numbers do not describe a view.
    """
    x, y, z = direction_from_angles(azimuth, elevation)
    return PinholeCamera((0.0, 0.0, 0.0), (x, y, z), field_of_view, *size)


def view_rays(camera: Camera) -> Tensor:
    """Unit directions of view `(height, width, 3)`, float64."""
    directions = torch.nn.functional.normalize(camera.rays()[1].double(), dim=-1)
    return directions.reshape(camera.height, camera.width, 3)


def build_plain(
    directions: Tensor,
    height: float,
    azimuth: float,
    sun: Tensor,
    sunlight: Tensor,
    medium: LayeredMedium,
    sky: Tensor | None,
    sky_ambient: Tensor | None = None,
) -> Backdrop:
    """The plain with poles and ridges under a gradient sky or a given one, lit by the sun through the fog.

    Args:
        directions: of view `(height, width, 3)`.
        height: of the eye above the ground [m].
        azimuth: towards which the poles and ridges stand [rad].
        sun: unit vector towards the sun `(3,)`.
        sunlight: radiance of a white surface that faces the sun above the fog `(channel,)` [1].
        medium: the fog, which dims the sun on the ground.
        sky: picture of the sky `(height, width, channel)`, or None for the gradient.
        sky_ambient: mean radiance of the sky `(channel,)` [1]; by default that of the gradient, or of the picture.

    Returns:
        The scene without the fog between it and the eye.
    """
    rows, columns = directions.shape[:2]
    flat = directions.reshape(-1, 3)
    origin = flat.new_tensor([0.0, 0.0, height]).expand_as(flat)
    found = trace_plain(origin, flat, azimuth)
    above = look_up_gradient_sky(flat, sun, sunlight) if sky is None else sky.reshape(-1, 3).to(flat)
    if sky_ambient is None:
        sky_ambient = mean_sky(sun, sunlight) if sky is None else above.mean(0)
    ambient = sky_ambient + DIFFUSE_SHARE * sun[2].clamp(min=0.0) * sunlight
    facing = (found.normal * sun).sum(-1).clamp(min=0.0)
    points = found.height.clamp(min=0.0)
    lit = torch.exp(-depth_to_sun(medium, points, sun)) * facing
    surface = found.albedo * (lit[:, None] * sunlight + (0.5 + 0.5 * found.normal[:, 2:]) * ambient)
    radiance = torch.where(torch.isinf(found.distance)[:, None], above, surface)
    return Backdrop(radiance.reshape(rows, columns, 3), found.distance.reshape(rows, columns), ambient)


def depth_to_sun(medium: LayeredMedium, height: Tensor, sun: Tensor) -> Tensor:
    """Optical depth [1] from heights [m] to the sun over the round earth; infinite in its shadow, 0 above the fog."""
    level = torch.maximum(height, torch.as_tensor(medium.base, dtype=height.dtype)) - medium.datum
    above = height > medium.top
    depth = medium.curved_depth(torch.where(above, 0.0, level), sun[2].to(height), EARTH_RADIUS)
    return torch.where(above, 0.0, depth)


def mean_sky(sun: Tensor, sunlight: Tensor) -> Tensor:
    """Mean radiance of the upper half of the gradient sky `(channel,)` [1]: midpoints in slope and azimuth."""
    steps = (torch.arange(SKY_SAMPLES, dtype=torch.float64) + 0.5) / SKY_SAMPLES
    slope, around = torch.meshgrid(steps, 2.0 * math.pi * steps, indexing="ij")
    level = (1.0 - slope.square()).sqrt()
    directions = torch.stack([level * around.sin(), level * around.cos(), slope], dim=-1)
    return look_up_gradient_sky(directions, sun.double(), sunlight.double()).mean((0, 1))


def photograph_backdrop(radiance: Tensor, distance: Tensor, name: str) -> Backdrop:
    """A photograph and its distances; the light in its fog is the mean of its sky, or else of what is farthest.

    Args:
        radiance: `(height, width, channel)` linear light [1].
        distance: along the view rays `(height, width)` [m]; infinite for the sky.
        name: of the file, for the message.

    Returns:
        The backdrop.

    Raises:
        ParameterError: for two sizes.
    """
    if radiance.shape[:2] != distance.shape:
        raise ParameterError(
            f"{name}: expected a depth map of the size of the picture, {radiance.shape[1]} x {radiance.shape[0]}, "
            f"got {distance.shape[1]} x {distance.shape[0]}"
        )
    far = torch.isinf(distance)
    if not bool(far.any()):
        count = max(1, int(FARTHEST_SHARE * distance.numel()))
        far = distance >= distance.flatten().topk(count).values[-1]
    return Backdrop(radiance.double(), distance.double(), radiance[far].double().mean(0))


def put_fog(
    backdrop: Backdrop, medium: LayeredMedium, height: float, directions: Tensor, light: FogLight
) -> FoggyPicture:
    """The backdrop through fog; under a low sun over the round earth.

    Args:
        backdrop: what is seen without fog.
        medium: the fog.
        height: of the eye [m].
        directions: of view `(height, width, 3)`.
        light: sun and ambient light.

    Returns:
        The picture and its layers.
    """
    low = float(light.sun_direction[2]) < LOW_SUN
    columns = [backdrop.radiance.flatten(0, 1), directions.flatten(0, 1), backdrop.distance.flatten()]
    parts = [
        compose_fog(behind, medium, height, direction, distance, light, EARTH_RADIUS if low else None)
        for behind, direction, distance in zip(*(column.split(CHUNK) for column in columns), strict=True)
    ]
    rows = backdrop.radiance.shape[:2]
    return FoggyPicture(
        torch.cat([part.radiance for part in parts]).unflatten(0, rows),
        torch.cat([part.transmittance[..., 0] for part in parts]).unflatten(0, rows),
        torch.cat([part.in_scattering for part in parts]).unflatten(0, rows),
        backdrop.distance,
    )
