"""From grey cloud layers to a colour image: sunlight, ambient light, the sky behind, and the air in between.

Dobashi et al. 2012, equations 3, 4 and 9, per pixel q and channel c:

    cloud(q, c) = c_in(c) L_in [single + multiple] + c_amb(c) ambient (1 - T) + T L_sky(q, c)
    image(q, c) = a(c) cloud(q, c) + (1 - a(c)) L_sky(q, c),      a = exp(-kappa_a t_c)

c_in and c_amb are the colours of sunlight and ambient light, T the transmittance, kappa_a t_c the optical depth of the air.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from render.scattering_stack import CloudLayers


@dataclass(frozen=True, eq=False)
class Lighting:
    """Light of a population of candidates; linear, relative to the photograph's display white.

    Args:
        sunlight_intensity: L_in `(population,)`.
        sunlight_colour: c_in `(channel,)`, largest channel 1.
        ambient: ambient radiance of an opaque cloud `(population,)`, L_amb / sigma_t of the paper.
        ambient_colour: c_amb `(channel,)` or `(population, channel)`.
    """

    sunlight_intensity: Tensor
    sunlight_colour: Tensor
    ambient: Tensor
    ambient_colour: Tensor


def compose_cloud(layers: CloudLayers, lighting: Lighting, sky: Tensor) -> Tensor:
    """Cloud in front of the sky, without air in between.

    Args:
        layers: grey layers `(population, pixel)`.
        lighting: of the population.
        sky: radiance behind the cloud `(channel, pixel)`.

    Returns:
        Linear radiance `(population, channel, pixel)`.
    """
    sunlit = lighting.sunlight_intensity[:, None] * (layers.single + layers.multiple)
    ambient = lighting.ambient[:, None] * layers.opacity
    ambient_colour = lighting.ambient_colour.expand(len(ambient), -1)
    return (
        lighting.sunlight_colour[None, :, None] * sunlit[:, None]
        + ambient_colour[:, :, None] * ambient[:, None]
        + layers.transmittance[:, None] * sky
    )


def blend_air(cloud: Tensor, sky: Tensor, air_depth: Tensor) -> Tensor:
    """Cloud seen through air that takes on the colour of the sky.

    Args:
        cloud: `(population, channel, pixel)`.
        sky: `(channel, pixel)`.
        air_depth: optical depth kappa_a t_c of the air `(population, channel)`.

    Returns:
        Linear radiance `(population, channel, pixel)`.
    """
    share = torch.exp(-air_depth)[:, :, None]
    return share * cloud + (1.0 - share) * sky
