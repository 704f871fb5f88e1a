"""Single scattering for every extinction at once, without sampling.

    S1(s) = integral of s rho(t) exp(-s (u(t) + u_sun(t))) dt                       (Dobashi et al. 2012, equation 5)

u is the optical length from the camera, u_sun the one to the sun. Both are taken as linear over a step, which makes the integral of
the step elementary: with d = s |du + du_sun|, the factor (1 - exp(-d)) / d stands for the falling exponential and is 1 at d = 0. It is
taken from the end of the step that more light reaches, so that no exponential can overflow.
"""

import torch
from torch import Tensor

from precompute.free_flight import DARKEST_DEPTH, march_to_sun
from render.density_grid import DensityGrid
from render.ray_march import RayProfile, march_rays, ray_chunks


def compute_single_scattering(
    grid: DensityGrid, origin: Tensor, direction: Tensor, sun_direction: Tensor, extinction: Tensor, step: float
) -> Tensor:
    """Single-scattering integral S1 of rays.

    Args:
        grid: the volume.
        origin: ray origins `(ray, 3)` [m].
        direction: unit directions `(ray, 3)`.
        sun_direction: unit vector towards the sun `(3,)`.
        extinction: coefficients `(extinction,)` [1/m].
        step: longest step in voxels.

    Returns:
        S1 `(extinction, ray)`, dimensionless; times albedo, phase function and sunlight it is the radiance.
    """
    parts = [
        _integrate_rays(grid, origin[rays], direction[rays], sun_direction, extinction, step)
        for rays in ray_chunks(grid, len(origin), step)
    ]
    return torch.cat(parts, dim=1) if parts else torch.zeros(len(extinction), 0)


def _integrate_rays(
    grid: DensityGrid, origin: Tensor, direction: Tensor, sun_direction: Tensor, extinction: Tensor, step: float
) -> Tensor:
    profile = march_rays(grid, origin, direction, step)
    sun_length = _sun_optical_length(grid, origin, direction, sun_direction, profile, extinction[0], step)
    lit = profile.optical_length + sun_length
    growth, change = profile.optical_length.diff(dim=1), lit.diff(dim=1).abs()
    nearer = torch.minimum(lit[:, :-1], lit[:, 1:])
    integrals = []
    for s in extinction:
        steps = s * growth * torch.exp(-s * nearer) * _mean_falloff(s * change)
        integrals.append(steps.sum(1, dtype=torch.float64))
    return torch.stack(integrals).to(torch.float32)


def _sun_optical_length(
    grid: DensityGrid,
    origin: Tensor,
    direction: Tensor,
    sun_direction: Tensor,
    profile: RayProfile,
    smallest_extinction: Tensor,
    step: float,
) -> Tensor:
    """Optical length to the sun at the edges of a profile `(ray, edge)` [m]; only where a step next to it can be seen and holds cloud."""
    visible = profile.optical_length[:, :-1] * smallest_extinction < DARKEST_DEPTH
    counts = visible & (profile.optical_length.diff(dim=1) > 0)
    needed = torch.nn.functional.pad(counts, (1, 0)) | torch.nn.functional.pad(counts, (0, 1))
    ray, edge = torch.nonzero(needed).unbind(1)
    points = origin[ray] + profile.distance[ray, edge, None] * direction[ray]
    result = torch.zeros_like(profile.distance)
    for part in torch.arange(len(ray)).split(1 << 16):
        result[ray[part], edge[part]] = march_to_sun(grid, points[part], sun_direction, smallest_extinction, step)
    return result


def _mean_falloff(depth: Tensor) -> Tensor:
    """Mean of exp(-x) over 0..depth, (1 - exp(-depth))/depth, which is 1 at zero; depth is not negative."""
    small = depth < 1e-4
    return torch.where(small, 1.0 - 0.5 * depth, -torch.expm1(-depth) / torch.where(small, 1.0, depth))
