"""Triangle meshes: what makes one usable, and OBJ files."""

import math
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import torch
from torch import Tensor

from render.errors import MissingExtraError, SceneError
from render.shafts.particles import Colour, check_colour

GREY: Colour = (0.35, 0.33, 0.30)
"""Albedo of a surface of which nothing is known [1]."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles that cast shadows from both sides, closed or not.

    Args:
        vertices: `(vertex, 3)` [m].
        triangles: numbers of three vertices each `(triangle, 3)`, at least one.
        albedo: of the diffuse surface, red, green and blue [1].
        name: for messages.

    Raises:
        SceneError: for other shapes, no triangle, a vertex that does not exist or is not finite.
    """

    vertices: Tensor
    triangles: Tensor
    albedo: Colour = GREY
    name: str = "mesh"

    def __post_init__(self) -> None:
        check_colour(f"albedo of {self.name}", self.albedo)
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3 or self.triangles.shape[1:] != (3,):
            raise SceneError(
                f"{self.name}: expected vertices (vertex, 3) and triangles (triangle, 3), got {tuple(self.vertices.shape)} "
                f"and {tuple(self.triangles.shape)}"
            )
        if not len(self.triangles):
            raise SceneError(f"{self.name}: expected at least one triangle of an area above 0, got none")
        if not bool(torch.isfinite(self.vertices).all()):
            raise SceneError(f"{self.name}: expected finite vertices, got NaN or infinite ones")
        first, last = int(self.triangles.min()), int(self.triangles.max())
        if first < 0 or last >= len(self.vertices):
            raise SceneError(
                f"{self.name}: a triangle names vertex {last if first >= 0 else first} of {len(self.vertices)}"
            )


def make_mesh(vertices: Tensor, triangles: Tensor, albedo: Colour = GREY, name: str = "mesh") -> Mesh:
    """A mesh without its triangles of no area, which no ray can meet.

    Args:
        vertices: `(vertex, 3)` [m].
        triangles: `(triangle, 3)`.
        albedo: red, green and blue [1].
        name: for messages.

    Raises:
        SceneError: see `Mesh`.
    """
    whole = Mesh(vertices.to(torch.float32), triangles.to(torch.int64), albedo, name)
    a, b, c = whole.vertices.double()[whole.triangles].unbind(1)
    area = torch.linalg.vector_norm(torch.linalg.cross(b - a, c - a), dim=-1)
    return whole if bool((area > 0.0).all()) else Mesh(whole.vertices, whole.triangles[area > 0.0], albedo, name)


def place_mesh(mesh: Mesh, *, scale: float = 1.0, turn: float = 0.0, offset: tuple[float, float, float]) -> Mesh:
    """The mesh scaled about the origin, turned about the vertical, and moved.

    Args:
        mesh: to be placed.
        scale: factor on all lengths, positive.
        turn: angle [rad], clockwise from above, as the azimuth runs.
        offset: where the origin of the mesh goes [m].

    Raises:
        SceneError: for a scale that is not positive, or an angle or offset that is not finite.
    """
    if not (0.0 < scale < math.inf and all(math.isfinite(part) for part in (turn, *offset))):
        raise SceneError(
            f"{mesh.name}: expected a positive scale and finite angles and offsets, got {scale}, {turn}, {offset}"
        )
    sine, cosine = math.sin(turn), math.cos(turn)
    rotation = mesh.vertices.new_tensor([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    moved = scale * (mesh.vertices @ rotation.T) + mesh.vertices.new_tensor(offset)
    return Mesh(moved, mesh.triangles, mesh.albedo, mesh.name)


def read_obj(path: Path | str, albedo: Colour = GREY, y_up: bool = True) -> Mesh:
    """Read the triangles of an OBJ file; polygons are cut into triangles, groups joined, materials left aside.

    Args:
        path: the file.
        albedo: of its surface [1].
        y_up: whether the y axis of the file points upwards, as modelling tools write it: (x, y, z) = (X, -Z, Y).

    Returns:
        The mesh, its numbers taken as metres.

    Raises:
        SceneError: the file is missing, holds no triangles, or numbers that are no mesh.
        MissingExtraError: trimesh is not installed.
    """
    path = Path(path)
    check_extra_installed("trimesh")
    import trimesh

    if not path.is_file():
        raise SceneError(f"{path}: no such file; check the name of the mesh")
    try:
        read = trimesh.load(str(path), file_type="obj", force="mesh", process=False, skip_materials=True)
        vertices, triangles = torch.tensor(read.vertices), torch.tensor(read.faces)
    except (ValueError, IndexError, KeyError, TypeError, AttributeError) as error:
        raise SceneError(f"{path}: not an OBJ file that can be read ({error})") from error
    if vertices.ndim != 2 or triangles.ndim != 2 or not len(triangles):
        raise SceneError(f"{path}: expected an OBJ file with triangles, found none")
    if y_up:
        vertices = torch.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], dim=1)
    return make_mesh(vertices, triangles, albedo, path.name)


def check_extra_installed(module: str) -> None:
    """Raise MissingExtraError unless a module of the extra `shafts` can be imported."""
    if find_spec(module) is None:
        raise MissingExtraError(f'meshes need {module}, which is not installed; try: pip install "cloudfit[shafts]"')
