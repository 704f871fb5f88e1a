"""Columns of air towards the sun as a table that is fine at the horizon, and the sunlight that it leaves.

The table's second axis is the square root of the sun's height above the horizon, as a share of the horizon's own distance from the
zenith, so its nodes crowd where columns change fastest. Columns, not transmittances, are interpolated: they have no wavelength and
no range of magnitudes.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.ray_geometry import distance_to_top_boundary, horizon_cosine
from render.atmosphere.shells import Shells, compute_columns
from render.atmosphere.table_interpolation import interpolate_table
from render.atmosphere.transmittance import visible_sun_share

ALTITUDES, HEIGHTS = 96, 512
"""Nodes of the axes: sunlight to 5e-4 at worst, and 1e-4 where the sun is well up."""


@dataclass(frozen=True, eq=False)
class SunColumns:
    """Columns from points in the air to its top.

    Args:
        atmosphere: the planet.
        columns: by altitude, height of the sun above the horizon and species `(altitude, height, species)` [m], float64.
    """

    atmosphere: AtmosphereParameters
    columns: Tensor


def sun_column_nodes(atmosphere: AtmosphereParameters, altitudes: int, heights: int) -> tuple[Tensor, Tensor]:
    """Radii [m] and cosines between sun and zenith of the nodes, each `(altitude, height)`, float64."""
    unit = torch.linspace(0.0, 1.0, altitudes, dtype=torch.float64)[:, None]
    radius = atmosphere.bottom_radius + atmosphere.thickness * unit * unit
    horizon = horizon_cosine(atmosphere, radius)
    height = torch.linspace(0.0, 1.0, heights, dtype=torch.float64)
    cosine = torch.cos(torch.acos(horizon) * (1.0 - height * height))
    cosine = torch.where(height == 0.0, horizon, cosine)
    return radius.expand_as(cosine), cosine


def build_sun_columns(shells: Shells, altitudes: int = ALTITUDES, heights: int = HEIGHTS) -> SunColumns:
    """Fill the table with exact columns.

    Args:
        shells: the air.
        altitudes, heights: nodes of the axes, at least two each.

    Returns:
        The table.
    """
    radius, cosine = sun_column_nodes(shells.atmosphere, altitudes, heights)
    to_top = distance_to_top_boundary(shells.atmosphere, radius, cosine)
    return SunColumns(shells.atmosphere, compute_columns(shells, radius, cosine, to_top))


def look_up_sun_columns(table: SunColumns, radius: Tensor, cos_sun: Tensor) -> Tensor:
    """Columns from points to the top of the air in the direction of the sun; below the horizon those of the horizon.

    Args:
        table: of the planet.
        radius: of the points from the centre `(...)` [m].
        cos_sun: cosine between sun and zenith `(...)`.

    Returns:
        Columns `(..., species)` [m].
    """
    altitudes, heights, _ = table.columns.shape
    planet = table.atmosphere
    altitude = ((radius - planet.bottom_radius) / planet.thickness).clamp(min=0.0).sqrt()
    horizon = torch.acos(horizon_cosine(planet, radius))
    height = (1.0 - torch.acos(cos_sun.clamp(-1.0, 1.0)) / horizon).clamp(min=0.0).sqrt()
    return interpolate_table(table.columns, (altitude * (altitudes - 1), height * (heights - 1)))


def look_up_sunlight(table: SunColumns, extinction: Tensor, radius: Tensor, cos_sun: Tensor) -> Tensor:
    """Share of the sun's light that reaches points: transmittance towards its centre times the visible share of its disc.

    Args:
        table: of the planet.
        extinction: of the species `(species, wavelength)` [1/m].
        radius: of the points from the centre `(...)` [m].
        cos_sun: cosine between sun and zenith `(...)`.

    Returns:
        Shares `(..., wavelength)` [1].
    """
    radius, cos_sun = torch.broadcast_tensors(radius, cos_sun)
    share = visible_sun_share(table.atmosphere, radius, cos_sun)
    lit = share > 0.0
    light = torch.zeros(*share.shape, extinction.shape[-1], dtype=extinction.dtype, device=extinction.device)
    columns = look_up_sun_columns(table, radius[lit], cos_sun[lit])
    light[lit] = torch.exp(-columns @ extinction) * share[lit][:, None]
    return light
