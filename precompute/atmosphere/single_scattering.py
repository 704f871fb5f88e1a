"""Light scattered once: integrals along a ray of what the sun sends there and the air lets through.

    rayleigh = E beta_R integral of rho_R(h) T(view) T(sun) ds,     mie = E beta_M integral of rho_M(h) T(view) T(sun) ds

E is the solar irradiance, beta the scattering coefficients at the largest densities, rho the densities, T the transmittances. The phase
functions are left out, so that both integrals are smooth in the angle to the sun (Bruneton & Neyret 2008, section 4).
"""

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from precompute.atmosphere.quadratures import LineRule
from render.atmosphere import table_mapping as mapping
from render.atmosphere.air_ray import AirRay
from render.atmosphere.parameters import AtmosphereParameters, evaluate_density, spectrum_tensor
from render.atmosphere.table_interpolation import nearest_nodes
from render.atmosphere.tables import TableSizes, scattering_nodes
from render.atmosphere.transmittance import (
    look_up_transmittance,
    look_up_transmittance_to_sun,
    visible_sun_share,
)

SAMPLES_AT_ONCE = 1 << 16
"""Points of rays that are worked on together: half a megabyte a number, so that most of them stay in the cache."""


def compute_single_scattering(
    atmosphere: AtmosphereParameters, transmittance: Tensor, ray: AirRay, rule: LineRule
) -> tuple[Tensor, Tensor]:
    """Light scattered once along rays, without the phase functions.

    Args:
        atmosphere: the planet.
        transmittance: table `(radius, view, wavelength)` [1].
        ray: rays `(...)`.
        rule: of the integral.

    Returns:
        By the air and by aerosols, each `(..., wavelength)` [W/m^2/nm].
    """
    positions, weights = rule.nodes()
    rays = ray.expanded().unsqueeze()
    length = rays.length(atmosphere)
    distance = length * positions
    point = rays.at(atmosphere, distance)
    passing = look_up_transmittance(
        atmosphere, transmittance, rays.radius, rays.cos_view, distance, rays.intersects_ground
    ) * look_up_transmittance_to_sun(atmosphere, transmittance, point.radius, point.cos_sun)
    altitude = point.radius - atmosphere.bottom_radius
    sums = []
    for profile, scattering in _kinds(atmosphere):
        density = evaluate_density(profile, altitude) * weights
        sums.append((passing * density[..., None]).sum(-2) * length * _source(atmosphere, scattering, passing))
    return sums[0], sums[1]


def build_single_scattering(
    atmosphere: AtmosphereParameters, sizes: TableSizes, transmittance: Tensor, radius_node: int, rule: LineRule
) -> tuple[Tensor, Tensor]:
    """Tables of light scattered once, at one radius.

    At a point of a ray the transmittance to the sun depends on the sun's height alone. So a row of it is prepared for each point, times
    everything else that the point contributes, and a node of the table is a weighted sum of two entries from each of these rows.

    Args:
        atmosphere: the planet.
        sizes: nodes of each axis.
        transmittance: table `(radius, view, wavelength)` [1].
        radius_node: number of the radius.
        rule: of the integral.

    Returns:
        By the air and by aerosols, each `(view, view_sun, sun, wavelength)` [W/m^2/nm].
    """
    rays = scattering_nodes(atmosphere, sizes, radius_node)
    nodes, points = sizes.view_suns * sizes.suns, rule.nodes()[0].shape[0]
    step = max(1, SAMPLES_AT_ONCE // (nodes * points))
    found = [
        _integrate_views(atmosphere, transmittance, rays, slice(start, start + step), rule)
        for start in range(0, sizes.views, step)
    ]
    values = torch.cat(found).reshape(sizes.views, sizes.view_suns, sizes.suns, 2, -1)
    return values[..., 0, :], values[..., 1, :]


def _integrate_views(
    atmosphere: AtmosphereParameters, transmittance: Tensor, rays: AirRay, views: slice, rule: LineRule
) -> Tensor:
    """Both integrals `(view, 2 wavelength)` for every height of the sun, flattened, of some of the views."""
    positions, weights = rule.nodes()
    view, ground = rays.cos_view[views, 0], rays.intersects_ground[views, 0]
    straight = AirRay(rays.radius, view, view, view, ground)
    length = straight.length(atmosphere)
    distance = length * positions
    radius = straight.at(atmosphere, distance).radius
    passing = look_up_transmittance(atmosphere, transmittance, rays.radius, view, distance, ground)
    altitude = radius - atmosphere.bottom_radius
    factors = [
        passing
        * (evaluate_density(profile, altitude) * weights * length)[..., None]
        * _source(atmosphere, scattering, passing)
        for profile, scattering in _kinds(atmosphere)
    ]
    rows = _rows_towards_sun(atmosphere, transmittance, radius)
    prepared = torch.cat([rows * factor[..., None, :] for factor in factors], -1)
    # Dimensions from here on: (view, view_sun, sun, point).
    there, reach = radius[:, None, None, :], distance[:, None, None, :]
    sun = (rays.radius * rays.cos_sun[..., None] + reach * rays.cos_view_sun[views, ..., None]) / there
    sun = sun.clamp(-1.0, 1.0)
    count = transmittance.shape[1]
    lower, above = nearest_nodes(mapping.unit_from_sky_view(atmosphere, there, sun) * (count - 1), count)
    share = visible_sun_share(atmosphere, there, sun)
    first = torch.arange(radius.numel()).reshape(len(radius), 1, 1, -1) * count + lower
    index = torch.stack([first, first + 1], -1).reshape(-1, 2 * len(positions))
    weight = torch.stack([(1.0 - above) * share, above * share], -1).reshape(index.shape)
    return embedding_bag(
        index, prepared.reshape(-1, prepared.shape[-1]), per_sample_weights=weight.to(prepared.dtype), mode="sum"
    )


def _rows_towards_sun(atmosphere: AtmosphereParameters, transmittance: Tensor, radius: Tensor) -> Tensor:
    """Transmittance to the top at every node of view `(..., view, wavelength)`, from radii `(...)` [m] between the table's."""
    radii = transmittance.shape[0]
    lower, above = nearest_nodes(mapping.unit_from_radius(atmosphere, radius) * (radii - 1), radii)
    weight = above[..., None, None].to(transmittance.dtype)
    return torch.lerp(transmittance[lower], transmittance[lower + 1], weight)


def _kinds(atmosphere: AtmosphereParameters) -> tuple:
    """Profile and scattering coefficient of the air and of aerosols."""
    return (
        (atmosphere.rayleigh_density, atmosphere.rayleigh_scattering),
        (atmosphere.mie_density, atmosphere.mie_scattering),
    )


def _source(atmosphere: AtmosphereParameters, scattering: tuple[float, ...], like: Tensor) -> Tensor:
    """Solar irradiance times a scattering coefficient `(wavelength,)` [W/m^3/nm]."""
    return spectrum_tensor(atmosphere.solar_irradiance, like) * spectrum_tensor(scattering, like)
