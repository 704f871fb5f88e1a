"""Light of the next order of scattering: the integral along a ray of the light scattered there into it.

L_n = integral of T(view) J(r_d, mu_d, mu_s_d, nu) ds,   J the scattering density of order n
"""

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from precompute.atmosphere.quadratures import LineRule
from render.atmosphere import table_mapping as mapping
from render.atmosphere.air_ray import AirRay
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.table_interpolation import nearest_nodes
from render.atmosphere.tables import TableSizes, look_up_scattering, scattering_nodes, view_index
from render.atmosphere.transmittance import look_up_transmittance

SAMPLES_AT_ONCE = 1 << 16
"""Points of rays that are worked on together: half a megabyte a number, so that most of them stay in the cache."""


def compute_multiple_scattering(
    atmosphere: AtmosphereParameters, transmittance: Tensor, density: Tensor, ray: AirRay, rule: LineRule
) -> Tensor:
    """Light of the order that a scattering density belongs to, along rays.

    Args:
        atmosphere: the planet.
        transmittance: table `(radius, view, wavelength)` [1].
        density: table of the scattering density `(radius, view, view_sun, sun, wavelength)` [W/m^3/sr/nm].
        ray: rays `(...)`.
        rule: of the integral.

    Returns:
        Radiance `(..., wavelength)` [W/m^2/sr/nm].
    """
    positions, weights = rule.nodes()
    rays = ray.expanded().unsqueeze()
    length = rays.length(atmosphere)
    distance = length * positions
    passing = look_up_transmittance(
        atmosphere, transmittance, rays.radius, rays.cos_view, distance, rays.intersects_ground
    )
    scattered = look_up_scattering(atmosphere, density, rays.at(atmosphere, distance))
    return (scattered * passing * (length * weights)[..., None].to(passing.dtype)).sum(-2)


def build_multiple_scattering(
    atmosphere: AtmosphereParameters,
    sizes: TableSizes,
    transmittance: Tensor,
    density: Tensor,
    radius_node: int,
    rule: LineRule,
) -> Tensor:
    """Table of the light of one order, at one radius.

    The points of a ray have places on the axes of radius and view that do not depend on the sun. So the density is
    interpolated in these two for all suns at once, times the transmittance and the weight of the point; a node of the table
    is then a weighted sum of four entries, neighbours in `view_sun` and `sun`, for each point.

    Args:
        atmosphere: the planet.
        sizes: nodes of each axis.
        transmittance: table `(radius, view, wavelength)` [1].
        density: table of the scattering density `(radius, view, view_sun, sun, wavelength)` [W/m^3/sr/nm].
        radius_node: number of the radius.
        rule: of the integral.

    Returns:
        Radiance `(view, view_sun, sun, wavelength)` [W/m^2/sr/nm].
    """
    rays = scattering_nodes(atmosphere, sizes, radius_node)
    step = max(1, SAMPLES_AT_ONCE // (sizes.view_suns * sizes.suns * rule.nodes()[0].shape[0]))
    found = [
        _integrate_views(atmosphere, transmittance, density, rays, slice(start, start + step), rule)
        for start in range(0, sizes.views, step)
    ]
    return torch.cat(found).reshape(sizes.views, sizes.view_suns, sizes.suns, -1)


def _integrate_views(
    atmosphere: AtmosphereParameters, transmittance: Tensor, density: Tensor, rays: AirRay, views: slice, rule: LineRule
) -> Tensor:
    """The integral for some of the views and every sun, flattened `(node, wavelength)`."""
    positions, weights = rule.nodes()
    view, ground = rays.cos_view[views, 0], rays.intersects_ground[views, 0]
    straight = AirRay(rays.radius, view, view, view, ground)
    length = straight.length(atmosphere)
    distance = length * positions
    points = straight.at(atmosphere, distance)
    passing = look_up_transmittance(atmosphere, transmittance, rays.radius, view, distance, ground)
    passing = passing * (length * weights)[..., None].to(passing.dtype)
    rows = _density_for_all_suns(atmosphere, density, points) * passing[..., None, None, :]
    # Dimensions from here on: (view, view_sun, sun, point).
    _, _, view_suns, suns, wavelengths = density.shape
    angle = rays.cos_view_sun[views]
    left, right = nearest_nodes(mapping.unit_from_cosine(angle) * (view_suns - 1), view_suns)
    sun = rays.radius * rays.cos_sun[..., None] + distance[:, None, None, :] * angle[..., None]
    sun = (sun / points.radius[:, None, None, :]).clamp(-1.0, 1.0)
    lower, above = nearest_nodes(mapping.unit_from_sun(atmosphere, sun) * (suns - 1), suns)
    first = torch.arange(distance.numel()).reshape(len(distance), 1, 1, -1) * view_suns + left[..., None]
    first = first * suns + lower
    right = right[..., None].expand_as(above)
    index = torch.stack([first, first + 1, first + suns, first + suns + 1], -1).reshape(-1, 4 * len(positions))
    both = above * right
    weight = torch.stack([1.0 - above - right + both, above - both, right - both, both], -1).reshape(index.shape)
    return embedding_bag(index, rows.reshape(-1, wavelengths), per_sample_weights=weight.to(rows.dtype), mode="sum")


def _density_for_all_suns(atmosphere: AtmosphereParameters, density: Tensor, points: AirRay) -> Tensor:
    """Density interpolated in radius and view `(..., view_sun, sun, wavelength)` at points `(...)` of rays."""
    radii, views = density.shape[:2]
    lower, above = nearest_nodes(mapping.unit_from_radius(atmosphere, points.radius) * (radii - 1), radii)
    left, right = nearest_nodes(view_index(atmosphere, views, points), views)
    index = torch.stack([(lower + i) * views + left + j for i in (0, 1) for j in (0, 1)], -1)
    weight = torch.stack([u * v for u in (1.0 - above, above) for v in (1.0 - right, right)], -1)
    found = embedding_bag(
        index.reshape(-1, 4),
        density.reshape(radii * views, -1),
        per_sample_weights=weight.reshape(-1, 4).to(density.dtype),
        mode="sum",
    )
    return found.reshape(*points.radius.shape, *density.shape[2:])
