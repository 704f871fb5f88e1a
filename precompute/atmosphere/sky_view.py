"""Fill the table of all that one camera sees of the air, from the integrals along rays in a grid of directions."""

import math

import torch
from torch import Tensor

from render.atmosphere.accurate_sky import RAYS_AT_ONCE, integrate_source, integrate_sunlight
from render.atmosphere.air_ray import AirRay
from render.atmosphere.ray_quadrature import place_nodes
from render.atmosphere.rays import chosen_rays
from render.atmosphere.sky import enter_air
from render.atmosphere.sky_view import (
    SkyView,
    angle_spans,
    azimuth_axis,
    check_altitude,
    horizon_angle,
    horizon_axis,
)
from render.atmosphere.source_function import SourceFunction
from render.camera import unit_direction
from render.errors import ParameterError

LOW, HIGH = (128, 96), (256, 192)
"""Elevations on each side of the horizon, and azimuths on one side of the sun, for cameras within the lower air and above it;
docs/atmosphere.md has the errors."""

HIGH_ALTITUDE = 20_000.0
"""Altitude of a camera above which the air is a thin band at the horizon, and its twilight narrow in azimuth [m]."""


def build_sky_view(
    source: SourceFunction,
    altitude: float,
    sun: Tensor,
    *,
    reach: float = math.inf,
    sizes: tuple[int, int] | None = None,
) -> SkyView:
    """What a camera sees of the air in all directions.

    Args:
        source: of the planet.
        altitude: of the camera above the ground [m]; may lie beyond the air.
        sun: vector towards the sun `(3,)`; z points to the zenith.
        reach: distance up to which the air is seen [m]: that of what stands in it.
        sizes: nodes on each side of the horizon and on one side of the sun; by default as the altitude asks for.

    Returns:
        The table.

    Raises:
        ParameterError: if the altitude is negative or not finite, the sun has no direction, the reach is not positive, or an axis has fewer
            than two nodes.
    """
    check_altitude(altitude)
    if not reach > 0.0:
        raise ParameterError(f"the air is seen up to a positive distance, not {reach} m")
    elevations, azimuths = sizes or (HIGH if altitude > HIGH_ALTITUDE else LOW)
    if min(elevations, azimuths) < 2:
        raise ParameterError(f"an axis needs at least two nodes, not {elevations} and {azimuths}")
    unit_direction(sun)  # refuses what has no direction
    sun = torch.nn.functional.normalize(sun.double(), dim=0)
    planet = source.atmosphere
    direction, ground = _grid(source, altitude, sun, elevations, azimuths)
    eye = direction.new_tensor([0.0, 0.0, planet.bottom_radius + altitude]).expand_as(direction)
    entered, entry, misses = enter_air(planet, eye, direction, sun.expand_as(direction))
    rays = AirRay(entered.radius, entered.cos_view, entered.cos_sun, entered.cos_view_sun, ground)
    length = torch.minimum(rays.length(planet), (reach - entry).clamp(min=0.0))
    columns, through = _integrate(source, rays, length)
    columns = torch.where(misses[:, None], 0.0, columns)
    through = torch.where(misses[:, None], 1.0, through)
    shape = (2 * elevations, azimuths, -1)
    return SkyView(source, altitude, sun, columns.reshape(shape), through.reshape(shape)[:, 0])


def _grid(
    source: SourceFunction, altitude: float, sun: Tensor, elevations: int, azimuths: int
) -> tuple[Tensor, Tensor]:
    """Directions of the nodes `(ray, 3)`, and whether they are below the horizon `(ray,)`."""
    up, down = angle_spans(source.atmosphere, altitude)
    share = horizon_axis(elevations)
    angle = horizon_angle(source.atmosphere, altitude) + torch.cat([-up * share, down * share])
    level = torch.linalg.vector_norm(sun[:2])
    ahead = sun[:2] / level if bool(level > 0.0) else sun.new_tensor([0.0, 1.0])
    turn = azimuth_axis(azimuths)
    flat = torch.stack(
        [
            torch.cos(turn) * ahead[0] + torch.sin(turn) * ahead[1],
            torch.cos(turn) * ahead[1] - torch.sin(turn) * ahead[0],
        ],
        -1,
    )
    direction = torch.cat(
        [
            torch.sin(angle)[:, None, None] * flat,
            torch.cos(angle)[:, None, None].expand(-1, azimuths, 1),
        ],
        -1,
    )
    ground = torch.arange(2 * elevations) >= elevations
    return direction.reshape(-1, 3), ground[:, None].expand(-1, azimuths).reshape(-1)


def _integrate(source: SourceFunction, rays: AirRay, length: Tensor) -> tuple[Tensor, Tensor]:
    """Columns of the table `(ray, 3 wavelength)` and transmittances `(ray, wavelength)`."""
    columns, through = [], []
    for some in torch.arange(len(length)).split(RAYS_AT_ONCE):
        here = chosen_rays(rays, some)
        nodes = place_nodes(source.shells, here, length[some], source.nodes)
        once = integrate_sunlight(source.shells, source.sun_columns, here, nodes)
        more = integrate_source(source.shells, source.source, here, nodes)
        columns.append(torch.cat([once.flatten(1), more], -1))
        through.append(nodes.transmittance_to_end)
    return torch.cat(columns), torch.cat(through)
