"""The sky and the light of an atmosphere in the units of a fog picture: a white surface that faces the sun above the air has radiance 1."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from cloudfit.sky_models import SkyModel
from render.atmosphere.spectral_colour import convert_to_linear_srgb, convert_to_luminance


@dataclass(frozen=True, eq=False)
class FogSky:
    """What an atmosphere shows behind fog and sends into it, linear light [1].

    Args:
        radiance: of the sky, its ground and the sun's disc `(height, width, channel)`.
        sunlight: radiance of a white surface that faces the sun at the eye `(channel,)`.
        ambient: mean radiance of all around the eye `(channel,)`.
    """

    radiance: Tensor
    sunlight: Tensor
    ambient: Tensor


def compose_fog_sky(model: SkyModel, altitude: float, directions: Tensor, sun: Tensor) -> FogSky:
    """See an atmosphere from a height.

    Args:
        model: of the sky.
        altitude: of the eye above the ground [m].
        directions: of view `(height, width, 3)`.
        sun: unit vector towards the sun `(3,)`.

    Returns:
        Sky and light, saturated colours held at zero.
    """
    wavelengths = model.atmosphere.wavelengths
    solar = torch.tensor(model.atmosphere.solar_irradiance, dtype=torch.float64)
    white = convert_to_luminance(solar, wavelengths) / math.pi

    def colour(radiance: Tensor) -> Tensor:
        return convert_to_linear_srgb(radiance, wavelengths).clamp(min=0.0) / white

    rows, columns = directions.shape[:2]
    sky = model.compose(altitude, directions.reshape(-1, 3), sun)
    sunlight, ambient = model.light_at(altitude, sun)
    return FogSky(colour(sky).reshape(rows, columns, 3), colour(sunlight / math.pi), colour(ambient))
