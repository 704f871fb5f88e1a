"""Shadows of a point light: for each direction from it, how far away the first surface is.

Six square maps on the faces of a cube around the light hold distances along the rays through the middles of their texels. A point is
lit if it is no farther than the surface in its direction. The axis of the largest component of the direction chooses the face, the two
others over it the place on the face: (y, z) for x, (z, x) for y, (x, y) for z.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from render.camera import Vector
from render.errors import ParameterError
from render.shafts.ray_casting import RayCaster

FACES = 6
"""Those of +x, -x, +y, -y, +z and -z."""


@dataclass(frozen=True, eq=False)
class CubeShadowMap:
    """Distances from a light.

    Args:
        position: of the light `(3,)` [m].
        distances: to the first surface `(6, row, column)` [m]; infinite where there is none.
    """

    position: Tensor
    distances: Tensor

    def look_up_lit(self, points: Tensor) -> Tensor:
        """Whether the light reaches points `(..., 3)` [m]: booleans `(...)`, by the nearest texel."""
        offset = points - self.position.to(points)
        axis = offset.abs().argmax(-1, keepdim=True)
        main = offset.gather(-1, axis)
        size = self.distances.shape[-1]
        # At the light itself all texels are equally near, and all are lit.
        span = torch.where(main == 0.0, 1.0, main.abs())
        place = torch.cat([offset.gather(-1, (axis + 1) % 3), offset.gather(-1, (axis + 2) % 3)], dim=-1) / span
        cell = ((0.5 + 0.5 * place) * size).long().clamp(0, size - 1)
        face = 2 * axis[..., 0] + (main[..., 0] < 0.0)
        first = self.distances[face, cell[..., 1], cell[..., 0]]
        return torch.linalg.vector_norm(offset, dim=-1) <= first


def face_directions(resolution: int) -> Tensor:
    """Unit vectors through the middles of the texels `(6, row, column, 3)`, float64."""
    middle = (torch.arange(resolution, dtype=torch.float64) + 0.5) * (2.0 / resolution) - 1.0
    second, first = torch.meshgrid(middle, middle, indexing="ij")
    faces = []
    for face in range(FACES):
        vector = torch.empty(resolution, resolution, 3, dtype=torch.float64)
        vector[..., face // 2] = 1.0 if face % 2 == 0 else -1.0
        vector[..., (face // 2 + 1) % 3], vector[..., (face // 2 + 2) % 3] = first, second
        faces.append(torch.nn.functional.normalize(vector, dim=-1))
    return torch.stack(faces)


def build_cube_shadow_map(caster: RayCaster, position: Vector, resolution: int) -> CubeShadowMap:
    """Cast a ray from the light through every texel.

    Args:
        caster: what throws shadows.
        position: of the light [m].
        resolution: texels along an edge of the cube, at least 1.

    Returns:
        The map.

    Raises:
        ParameterError: for a resolution below 1.
    """
    if resolution < 1:
        raise ParameterError(f"expected a shadow map of at least one texel, got a resolution of {resolution}")
    directions = face_directions(resolution)
    light = torch.tensor(position, dtype=torch.float32)
    distances = [
        caster.find_distance(light.expand(resolution**2, 3), face.reshape(-1, 3)).reshape(resolution, resolution)
        for face in directions
    ]
    return CubeShadowMap(light, torch.stack(distances).contiguous())
