"""Shadows in a grid of voxels around the line from eye to light: Wyman & Dai 2013, "Imperfect voxelized shadow volumes", after Wyman 2011.

A point lies in a half-plane that begins at the line from the eye to the light, told by its angle alpha around that line; within it on
one ray from the eye, told by its angle theta from that line, and on one ray from the light, told by its place phi. Along a ray from the
light theta grows. So of the voxels (alpha, theta, phi) with one alpha and one phi, all from that of the first occluder on are dark: a
scan over one row of bits in the paper, and here one number, that of the first dark voxel.

For a lamp phi is the angle at the lamp, for the sun the distance from the line through the eye. Imperfect are the shadows' borders, which
lie on those of voxels. The paper fills the grid from shadow maps and sums over samples of an area light; here one ray is cast for each
(alpha, phi), and the light is a point.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.camera import Vector
from render.errors import ParameterError
from render.shafts.ray_casting import RayCaster
from render.shafts.rays import ViewRays
from render.shafts.shadow_map import light_axes

FAR = 4.0
"""Sizes of a scene away from the eye at which rays of the sun begin."""


@dataclass(frozen=True)
class VoxelCounts:
    """Numbers of voxels.

    Args:
        planes: half-planes, alpha.
        view_rays: rays of the eye in each, theta.
        light_rays: rays of the light in each, phi.

    Raises:
        ParameterError: for none.
    """

    planes: int = 512
    view_rays: int = 256
    light_rays: int = 256

    def __post_init__(self) -> None:
        if min(self.planes, self.view_rays, self.light_rays) < 1:
            raise ParameterError(f"expected at least one voxel along each axis, got {self}")


@dataclass(frozen=True, eq=False)
class VoxelShadows:
    """A grid of voxels of one light.

    Args:
        eye: `(3,)` [m].
        axes: across, up, and from the eye to the light `(3, 3)`, one a row.
        light_distance: from the eye [m]; infinite for the sun.
        lower: lowest alpha [rad], theta [rad] and phi ([rad] for a lamp, [m] for the sun) `(3,)`.
        voxel: sides of a voxel in the same units `(3,)`.
        first_dark: number of the first dark voxel along theta `(plane, light ray)`; beyond the last for none.
    """

    eye: Tensor
    axes: Tensor
    light_distance: float
    lower: Tensor
    voxel: Tensor
    first_dark: Tensor

    def look_up_lit(self, points: Tensor) -> Tensor:
        """Whether the light reaches points `(..., 3)` [m], by the voxel that holds each: booleans `(...)`."""
        place = (points.double() - self.eye) @ self.axes.T
        found = _angles(place, self.light_distance)
        alpha = (found[..., 0] - self.lower[0]) % (2.0 * math.pi)
        cell = torch.stack([alpha, *(found - self.lower).unbind(-1)[1:]], dim=-1) / self.voxel
        planes, light_rays = self.first_dark.shape
        plane = cell[..., 0].long().clamp(0, planes - 1)
        light_ray = cell[..., 2].floor().long().clamp(0, light_rays - 1)
        # By rounding, points of the first ray may lie before the first voxel.
        view_ray = cell[..., 1].floor().long().clamp(min=0)
        return view_ray < self.first_dark[plane, light_ray]


def build_voxel_shadows(
    caster: RayCaster, towards: Vector, rays: ViewRays, counts: VoxelCounts, at_infinity: bool
) -> VoxelShadows:
    """Fill the grid by casting one ray from the light for each of its rays.

    Args:
        caster: what throws shadows.
        towards: unit vector towards the sun, or the position of a lamp [m].
        rays: all from one eye; the grid covers them.
        counts: of voxels.
        at_infinity: whether the light is the sun.

    Returns:
        The grid.

    Raises:
        ParameterError: for rays from several eyes, or a lamp at the eye.
    """
    eye = rays.origin[0].double()
    if bool((rays.origin != rays.origin[:1]).any()):
        raise ParameterError("voxels around the line from eye to light need rays from one eye")
    offset = eye.new_tensor(towards) - (0.0 if at_infinity else eye)
    distance = float(torch.linalg.vector_norm(offset))
    if distance == 0.0:
        raise ParameterError("a lamp at the eye has no line to it")
    x, y, z = (offset / distance).tolist()
    axes, light_distance = light_axes((x, y, z)), math.inf if at_infinity else distance
    local = rays.direction.double() @ axes.T
    ends = _angles(rays.distance.double()[:, None] * local, light_distance)
    lowest_alpha, width = _cover_circle(ends[:, 0])
    lower = torch.stack([lowest_alpha, ends[:, 1].min(), ends.new_tensor(0.0)])
    extent = torch.stack([width, ends[:, 1].max() - lower[1], ends[:, 2].max()])
    sizes = extent.new_tensor([counts.planes, counts.view_rays, counts.light_rays])
    # The outermost rays lie within the last voxels, not beyond.
    voxel = torch.where(extent > 0.0, extent, 1.0) / sizes * (1.0 + 1e-6)
    reach = FAR * float(rays.distance.max())
    theta = _first_angles(caster, eye, axes, light_distance, lower, voxel, (counts.planes, counts.light_rays), reach)
    first = ((theta - lower[1]) / voxel[1]).floor().clamp(0, counts.view_rays + 1)
    return VoxelShadows(eye, axes, light_distance, lower, voxel, first.long())


def _angles(place: Tensor, light_distance: float) -> Tensor:
    """Alpha, theta and phi `(..., 3)` of places `(..., 3)` [m] relative to the eye, the light on the third axis."""
    aside = torch.linalg.vector_norm(place[..., :2], dim=-1)
    alpha, theta = torch.atan2(place[..., 1], place[..., 0]), torch.atan2(aside, place[..., 2])
    phi = aside if math.isinf(light_distance) else torch.atan2(aside, light_distance - place[..., 2])
    return torch.stack([alpha, theta, phi], dim=-1)


def _cover_circle(angles: Tensor) -> tuple[Tensor, Tensor]:
    """Beginning and width of the shortest arc that holds all angles [rad]."""
    rising = angles.sort().values
    gaps = torch.cat([rising[1:] - rising[:-1], (rising[0] + 2.0 * math.pi - rising[-1])[None]])
    widest = gaps.argmax()
    return rising[(widest + 1) % len(rising)], 2.0 * math.pi - gaps[widest]


def _first_angles(
    caster: RayCaster,
    eye: Tensor,
    axes: Tensor,
    light_distance: float,
    lower: Tensor,
    voxel: Tensor,
    shape: tuple[int, int],
    reach: float,
) -> Tensor:
    """Theta of the first occluder of each ray from the light `(plane, light ray)` [rad]; infinite for none."""
    plane, light_ray = (torch.arange(size, dtype=torch.float64) + 0.5 for size in shape)
    alpha, phi = torch.meshgrid(lower[0] + plane * voxel[0], lower[2] + light_ray * voxel[2], indexing="ij")
    outward = torch.stack([alpha.cos(), alpha.sin(), torch.zeros_like(alpha)], dim=-1)
    back = torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)
    if math.isinf(light_distance):
        start = phi[..., None] * outward - reach * back
        direction = back.expand_as(start)
    else:
        start = (-light_distance * back).expand_as(outward)
        direction = phi.sin()[..., None] * outward + phi.cos()[..., None] * back
    origin = eye + start.reshape(-1, 3) @ axes
    fallen = caster.find_distance(origin, direction.reshape(-1, 3) @ axes).double().reshape(shape)
    met = torch.isfinite(fallen)
    occluder = start + torch.where(met, fallen, 0.0)[..., None] * direction
    return torch.where(met, _angles(occluder, light_distance)[..., 1], math.inf)
