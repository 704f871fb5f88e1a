"""Nodes along rays through the air: few, and where the light is.

The densities fall off from the lowest point of a ray. So the ray is cut there into two legs, or in two parts if it only rises or
only sinks, and on each leg the distance from the lowest point is s = S u^2 with Gauss-Legendre nodes in u: they crowd where the air
is dense. The optical depth up to a node is the exact integral of the polynomial through the extinctions at the nodes of its leg, so
it needs no nodes of its own.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from torch import Tensor

from render.atmosphere.air_ray import AirRay
from render.atmosphere.ray_geometry import clamp_radius, sine_from_cosine
from render.atmosphere.shells import Shells, gauss_legendre, species_densities


@dataclass(frozen=True, eq=False)
class RayNodes:
    """Nodes of rays and what the air does between them and the origins.

    Args:
        distance: from the origin `(ray, node)` [m].
        weight: of an integral over distance `(ray, node)` [m].
        density: relative, of molecules, aerosols and absorbers `(ray, node, species)` [1].
        transmittance: from the origin `(ray, node, wavelength)` [1].
        transmittance_to_end: of the whole ray `(ray, wavelength)` [1].
    """

    distance: Tensor
    weight: Tensor
    density: Tensor
    transmittance: Tensor
    transmittance_to_end: Tensor

    def scattering_weights(self, shells: Shells) -> Tensor:
        """Weight times transmittance times the scattering of molecules and aerosols `(ray, node, species, wavelength)` [1]."""
        weight = self.weight[..., None] * self.transmittance
        return weight[..., None, :] * self.density[..., :2, None] * shells.scattering


def place_nodes(shells: Shells, rays: AirRay, length: Tensor, nodes: int) -> RayNodes:
    """Place nodes along rays.

    Args:
        shells: the air.
        rays: `(ray,)`, float64.
        length: of each, within the air `(ray,)` [m].
        nodes: of each of the two legs.

    Returns:
        Nodes in the order in which the ray meets them, twice as many as on a leg.
    """
    begin = rays.radius * rays.cos_view
    end = begin + length
    impact = rays.radius * sine_from_cosine(rays.cos_view)
    rises, sinks = begin >= 0.0, end <= 0.0
    nearest = torch.where(rises, begin, torch.where(sinks, end, torch.zeros_like(begin)))
    node, weight = gauss_legendre(nodes)
    # Ends of the legs in u: rising 0 .. 1/2 .. 1, sinking 1 .. 1/2 .. 0, through the nearest point 1 .. 0 and 0 .. 1.
    single = rises | sinks
    half = torch.where(single, 0.5, 0.0).to(begin)
    legs = (
        (torch.where(rises, 0.0, 1.0).to(begin), half, torch.where(rises, end, begin) - nearest),
        (half, torch.where(sinks, 0.0, 1.0).to(begin), torch.where(sinks, begin, end) - nearest),
    )
    along, slope = [], []
    for first, last, reach in legs:
        u = first[:, None] + (last - first)[:, None] * node
        along.append(nearest[:, None] + reach[:, None] * u * u)
        slope.append(2.0 * reach[:, None] * u * (last - first)[:, None])
    there, step = torch.cat(along, 1), torch.cat(slope, 1)
    radius = clamp_radius(shells.atmosphere, torch.hypot(there, impact[:, None]))
    density = species_densities(shells.atmosphere, radius - shells.atmosphere.bottom_radius)
    per_node = (density @ shells.extinction) * step[..., None]
    depth, whole = _optical_depths(per_node, nodes, weight)
    return RayNodes(
        (there - begin[:, None]).clamp(min=0.0),
        step * weight.repeat(2),
        density,
        torch.exp(-depth),
        torch.exp(-whole),
    )


def _optical_depths(per_node: Tensor, nodes: int, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Optical depths up to the nodes `(ray, node, wavelength)` and to the end, from extinction times step at each node."""
    near, far = per_node[:, :nodes], per_node[:, nodes:]
    of_near = (near * weight[:, None]).sum(1)
    running = _running_integral(nodes)
    depth = torch.cat([running @ near, of_near[:, None] + running @ far], dim=1)
    # The polynomial may dip below zero where there is next to nothing.
    return depth.clamp(min=0.0), of_near + (far * weight[:, None]).sum(1)


@cache
def _running_integral(nodes: int) -> Tensor:
    """Integrals from 0 to each Gauss-Legendre node of 0..1 of the polynomial through values at the nodes `(node, node)`."""
    abscissa = np.polynomial.legendre.leggauss(nodes)[0]
    values = np.polynomial.legendre.legvander(abscissa, nodes - 1)
    integrals = [
        np.polynomial.legendre.legval(abscissa, np.polynomial.legendre.legint(unit, lbnd=-1.0))
        for unit in np.eye(nodes)
    ]
    return torch.from_numpy(0.5 * np.stack(integrals, axis=-1) @ np.linalg.inv(values))
