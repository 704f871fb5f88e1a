"""The tables of an atmosphere: their sizes, their nodes, and how each is looked up at any point."""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from render.atmosphere import table_mapping as mapping
from render.atmosphere.air_ray import AirRay
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.table_interpolation import interpolate_table
from render.errors import ParameterError

LARGEST_TABLE = 1 << 28
"""Nodes of a table beyond which it is refused before anything is allocated."""


@dataclass(frozen=True)
class TableSizes:
    """Nodes of each axis; the defaults are Bruneton's.

    Args:
        transmittance_radii, transmittance_views: of the transmittance.
        irradiance_radii, irradiance_suns: of the irradiance of the ground and of surfaces in the air.
        radii, views, view_suns, suns: of scattered light; half of the views meet the ground, half do not.

    Raises:
        ParameterError: if an axis has fewer than two nodes, the views are odd or fewer than four, or a table is too large to be meant.
    """

    transmittance_radii: int = 64
    transmittance_views: int = 256
    irradiance_radii: int = 16
    irradiance_suns: int = 64
    radii: int = 32
    views: int = 128
    view_suns: int = 8
    suns: int = 32

    def __post_init__(self) -> None:
        for field in fields(self):
            if getattr(self, field.name) < 2:
                raise ParameterError(f"{field.name} must be at least 2 to interpolate, not {getattr(self, field.name)}")
        if self.views % 2 or self.views < 4:
            raise ParameterError(f"views must be even, half of them for the ground, and at least 4, not {self.views}")
        if self.radii * self.views * self.view_suns * self.suns > LARGEST_TABLE:
            raise ParameterError(f"tables of more than {LARGEST_TABLE:,} nodes are refused: {self}")

    @property
    def scattering(self) -> tuple[int, int, int, int]:
        """Nodes of a table of scattered light `(radius, view, view_sun, sun)`."""
        return self.radii, self.views, self.view_suns, self.suns


DEFAULT_SIZES = TableSizes()
"""Bruneton's: 25 MB a table of scattered light for three wavelengths in float64."""


@dataclass(frozen=True, eq=False)
class AtmosphereTables:
    """All that the look-ups of an atmosphere need.

    Args:
        atmosphere: that they were made for.
        transmittance: to the top of the air `(radius, view, wavelength)` [1].
        irradiance: by the sky, of a horizontal surface `(radius, sun, wavelength)` [W/m^2/nm]; light scattered up to `orders` - 1 times.
        scattering: `(radius, view, view_sun, sun, wavelength)` [W/m^2/nm]: light scattered once by air and more often by both, each
            divided by the Rayleigh phase function.
        single_mie: light scattered once by aerosols without its phase function, shape and unit of `scattering`.
        orders: how often light may have been scattered.

    Raises:
        ParameterError: if the shapes do not fit together or to the atmosphere.
    """

    atmosphere: AtmosphereParameters
    transmittance: Tensor
    irradiance: Tensor
    scattering: Tensor
    single_mie: Tensor
    orders: int

    def __post_init__(self) -> None:
        for name, dimensions in (("transmittance", 3), ("irradiance", 3), ("scattering", 5), ("single_mie", 5)):
            shape = getattr(self, name).shape
            if len(shape) != dimensions or shape[-1] != len(self.atmosphere.wavelengths):
                raise ParameterError(
                    f"expected the {name} of {dimensions} dimensions, the last for {len(self.atmosphere.wavelengths)} "
                    f"wavelengths, not {tuple(shape)}"
                )
        if self.scattering.shape != self.single_mie.shape:
            raise ParameterError(
                f"scattering {tuple(self.scattering.shape)} and single_mie {tuple(self.single_mie.shape)} differ in shape"
            )


def transmittance_nodes(atmosphere: AtmosphereParameters, sizes: TableSizes) -> tuple[Tensor, Tensor]:
    """Radii `(radius, 1)` [m] and cosines between ray and zenith `(radius, view)` of the transmittance, float64."""
    unit = _unit_nodes(sizes.transmittance_radii)[:, None]
    views = mapping.sky_view_from_unit(atmosphere, unit, _unit_nodes(sizes.transmittance_views))
    return mapping.radius_from_unit(atmosphere, unit), views


def irradiance_nodes(atmosphere: AtmosphereParameters, sizes: TableSizes) -> tuple[Tensor, Tensor]:
    """Radii `(radius, 1)` [m] and cosines between sun and zenith `(sun,)` of the irradiance, float64."""
    radius = mapping.altitude_from_unit(atmosphere, _unit_nodes(sizes.irradiance_radii))[:, None]
    return radius, mapping.cosine_from_unit(_unit_nodes(sizes.irradiance_suns))


def scattering_nodes(atmosphere: AtmosphereParameters, sizes: TableSizes, radius_node: int) -> AirRay:
    """Rays of the nodes of scattered light at one radius, float64, broadcasting to `(view, view_sun, sun)`.

    The angle between ray and sun is at least the difference and at most the sum of their angles to the zenith, so nodes outside are
    moved to the nearest that exists.

    Args:
        atmosphere: the planet.
        sizes: nodes of each axis.
        radius_node: number of the radius.
    """
    half, unit_radius = _unit_nodes(sizes.views // 2), _unit_nodes(sizes.radii)[radius_node]
    radius = mapping.radius_from_unit(atmosphere, unit_radius)
    ground = mapping.ground_view_from_unit(atmosphere, unit_radius, half.flip(0))
    view = torch.cat([ground, mapping.sky_view_from_unit(atmosphere, unit_radius, half)])[:, None, None]
    sun = mapping.sun_from_unit(atmosphere, _unit_nodes(sizes.suns))
    spread = ((1.0 - view) * (1.0 + view) * ((1.0 - sun) * (1.0 + sun))).clamp(min=0.0).sqrt()
    view_sun = mapping.cosine_from_unit(_unit_nodes(sizes.view_suns))[:, None]
    view_sun = view_sun.maximum(view * sun - spread).minimum(view * sun + spread)
    below = (torch.arange(sizes.views) < sizes.views // 2)[:, None, None]
    return AirRay(radius, view, sun, view_sun, below)


def _unit_nodes(count: int) -> Tensor:
    return torch.arange(count, dtype=torch.float64) / (count - 1)


def view_index(atmosphere: AtmosphereParameters, views: int, ray: AirRay) -> Tensor:
    """Place of rays on the axis of views, in nodes `(...)`: from the horizon to the nadir, then from the zenith to the horizon."""
    last = views // 2 - 1
    ground = mapping.unit_from_ground_view(atmosphere, ray.radius, ray.cos_view).clamp(0.0, 1.0)
    sky = mapping.unit_from_sky_view(atmosphere, ray.radius, ray.cos_view).clamp(0.0, 1.0)
    return torch.where(ray.intersects_ground, last - last * ground, last + 1 + last * sky)


def look_up_scattering(atmosphere: AtmosphereParameters, table: Tensor, ray: AirRay) -> Tensor:
    """Interpolate a table of scattered light, or of its source.

    Args:
        atmosphere: the planet.
        table: `(radius, view, view_sun, sun, wavelength)`.
        ray: rays `(...)`.

    Returns:
        Values `(..., wavelength)` in the unit of the table.
    """
    radii, views, view_suns, suns, _ = table.shape
    return interpolate_table(
        table,
        (
            mapping.unit_from_radius(atmosphere, ray.radius) * (radii - 1),
            view_index(atmosphere, views, ray),
            mapping.unit_from_cosine(ray.cos_view_sun) * (view_suns - 1),
            mapping.unit_from_sun(atmosphere, ray.cos_sun) * (suns - 1),
        ),
    )


def look_up_irradiance(atmosphere: AtmosphereParameters, table: Tensor, radius: Tensor, cos_sun: Tensor) -> Tensor:
    """Interpolate the irradiance of a horizontal surface.

    Args:
        atmosphere: the planet.
        table: `(radius, sun, wavelength)` [W/m^2/nm].
        radius: of the surface from the centre `(...)` [m].
        cos_sun: cosine between sun and zenith `(...)`.

    Returns:
        Irradiance `(..., wavelength)` [W/m^2/nm].
    """
    radii, suns, _ = table.shape
    places = (
        mapping.unit_from_altitude(atmosphere, radius) * (radii - 1),
        mapping.unit_from_cosine(cos_sun) * (suns - 1),
    )
    return interpolate_table(table, places)
