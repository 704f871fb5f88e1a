"""Rays against triangles, by Embree: the nearest surface, and whether anything stands in the way."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from render.shafts.mesh import Mesh, check_extra_installed
from render.shafts.particles import Colour


@dataclass(frozen=True, eq=False)
class Hits:
    """What rays meet.

    Args:
        distance: `(ray,)` [m]; infinite where they meet nothing.
        normal: unit vectors that face the ray `(ray, 3)`; 0 where there is nothing.
        albedo: `(ray, channel)` [1]; 0 where there is nothing.
    """

    distance: Tensor
    normal: Tensor
    albedo: Tensor


class RayCaster:
    """Meshes prepared for ray casting; answers are float32 on the CPU.

    Args:
        meshes: none is an empty scene.

    Raises:
        MissingExtraError: embreex is not installed, and there is a mesh.
    """

    def __init__(self, meshes: tuple[Mesh, ...]) -> None:
        self._scene: Any = None
        self._normals = torch.zeros(1, 3)
        self._albedos = torch.zeros(1, 3)
        self.lower: Tensor | None = None
        self.upper: Tensor | None = None
        if not meshes:
            return
        check_extra_installed("embreex")
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        corners = torch.cat([mesh.vertices[mesh.triangles] for mesh in meshes])
        edges = corners.double()[:, 1:] - corners.double()[:, :1]
        normals = torch.nn.functional.normalize(torch.linalg.cross(edges[:, 0], edges[:, 1]), dim=-1)
        # The last row is that of rays that meet nothing, whose triangle has the number -1.
        self._normals = torch.cat([normals.float(), self._normals])
        self._albedos = torch.cat([_albedos(mesh) for mesh in meshes] + [self._albedos])
        self.lower = corners.amin((0, 1))
        self.upper = corners.amax((0, 1))
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, np.ascontiguousarray(corners.numpy()))

    @property
    def empty(self) -> bool:
        """Whether there is nothing to meet."""
        return self._scene is None

    def find_distance(self, origin: Tensor, direction: Tensor) -> Tensor:
        """Distance `(ray,)` [m] from origins `(ray, 3)` [m] along unit directions to what they meet; infinite for nothing."""
        if self._scene is None or not len(origin):
            return torch.full((len(origin),), torch.inf)
        found = torch.from_numpy(self._run(origin, direction, "DISTANCE", None))
        return torch.where(found < 1e36, found, torch.inf)

    def find_surface(self, origin: Tensor, direction: Tensor) -> Hits:
        """What rays from origins `(ray, 3)` [m] along unit directions meet first."""
        if self._scene is None or not len(origin):
            nothing = torch.zeros(len(origin), 3)
            return Hits(torch.full((len(origin),), torch.inf), nothing, nothing)
        found = self._run(origin, direction, "INTERSECT", True)
        number = torch.from_numpy(found["primID"]).long()
        distance = torch.where(number >= 0, torch.from_numpy(found["tfar"]), torch.inf)
        normal = self._normals[number]
        facing = (normal * direction.to(normal)).sum(-1, keepdim=True) < 0.0
        return Hits(distance, torch.where(facing, normal, -normal), self._albedos[number])

    def find_occluded(self, origin: Tensor, direction: Tensor, distance: Tensor) -> Tensor:
        """Booleans `(ray,)`: whether something stands between origins `(ray, 3)` [m] and a distance `(ray,)` [m]."""
        if self._scene is None or not len(origin):
            return torch.zeros(len(origin), dtype=torch.bool)
        limit = distance.to(torch.float32).clamp(max=1e36).contiguous().numpy()
        return torch.from_numpy(self._run(origin, direction, "OCCLUDED", limit) >= 0)

    def _run(self, origin: Tensor, direction: Tensor, query: str, limit: Any) -> Any:
        rays = [part.detach().to("cpu", torch.float32).contiguous().numpy() for part in (origin, direction)]
        output = True if query == "INTERSECT" else None
        limits = None if query == "INTERSECT" else limit
        return self._scene.run(*rays, dists=limits, query=query, output=output)


@dataclass(frozen=True, eq=False)
class SunRays:
    """Which points see the sun, by one ray each: exact, and slower than a map."""

    caster: RayCaster
    direction: tuple[float, float, float]

    def look_up_lit(self, points: Tensor) -> Tensor:
        """Booleans `(...)` of points `(..., 3)` [m]."""
        flat = points.reshape(-1, 3)
        towards = flat.new_tensor(self.direction).expand_as(flat)
        blocked = self.caster.find_occluded(flat, towards, torch.full((len(flat),), torch.inf))
        return ~blocked.reshape(points.shape[:-1])


@dataclass(frozen=True, eq=False)
class PointRays:
    """Which points see a point light, by one ray each: exact, and slower than a map."""

    caster: RayCaster
    position: tuple[float, float, float]

    def look_up_lit(self, points: Tensor) -> Tensor:
        """Booleans `(...)` of points `(..., 3)` [m]."""
        flat = points.reshape(-1, 3)
        offset = flat - flat.new_tensor(self.position)
        distance = torch.linalg.vector_norm(offset, dim=-1)
        unit = offset / torch.where(distance > 0.0, distance, 1.0)[:, None]
        light = flat.new_tensor(self.position).expand_as(flat)
        return ~self.caster.find_occluded(light, unit, distance).reshape(points.shape[:-1])


def _albedos(mesh: Mesh) -> Tensor:
    colour: Colour = mesh.albedo
    return torch.tensor(colour).expand(len(mesh.triangles), 3)
