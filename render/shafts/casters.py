"""Things that cast shadows, made here: sphere, columns, window, ridge, ground."""

import math

import torch
from torch import Tensor

from render.errors import SceneError
from render.shafts.mesh import GREY, Mesh, make_mesh
from render.shafts.particles import Colour

GRASS: Colour = (0.10, 0.13, 0.05)
ROCK: Colour = (0.22, 0.19, 0.16)
STONE: Colour = (0.45, 0.40, 0.33)
"""Albedos [1], chosen by eye."""


def join_meshes(meshes: list[Mesh], name: str) -> Mesh:
    """One mesh of several, with the albedo of the first. Raises SceneError where there is none."""
    if not meshes:
        raise SceneError(f"{name}: expected at least one part")
    starts = torch.tensor([0, *(len(mesh.vertices) for mesh in meshes[:-1])]).cumsum(0).tolist()
    triangles = torch.cat([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)])
    return Mesh(torch.cat([mesh.vertices for mesh in meshes]), triangles, meshes[0].albedo, name)


def make_box(lower: tuple[float, float, float], upper: tuple[float, float, float], albedo: Colour = GREY) -> Mesh:
    """A box between two corners [m]: 12 triangles. Raises SceneError unless the second corner is beyond the first."""
    if not all(first < last for first, last in zip(lower, upper, strict=True)):
        raise SceneError(f"box: expected a lower and an upper corner, got {lower} and {upper}")
    corners = torch.tensor([lower, upper], dtype=torch.float64)
    vertices = torch.stack([corners[i, [0, 1, 2]] for i in torch.cartesian_prod(*[torch.arange(2)] * 3)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = torch.tensor([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])
    return make_mesh(vertices, triangles, albedo, "box")


def make_sphere(centre: tuple[float, float, float], radius: float, rings: int = 64, albedo: Colour = GREY) -> Mesh:
    """A sphere of so many rings of triangles; its corners lie on the sphere, so it is a little too small.

    The volume is short by a relative pi^2 / rings^2, roughly. 64 rings have 16 000 triangles.

    Args:
        centre: [m].
        radius: [m], positive.
        rings: at least 3.
        albedo: [1].

    Raises:
        SceneError: for a radius that is not positive, or too few rings.
    """
    if not 0.0 < radius < math.inf or rings < 3:
        raise SceneError(f"sphere: expected a positive radius and at least 3 rings, got {radius} m and {rings}")
    polar = torch.arange(rings + 1, dtype=torch.float64) * math.pi / rings
    around = torch.arange(2 * rings, dtype=torch.float64) * math.pi / rings
    theta, phi = torch.meshgrid(polar, around, indexing="ij")
    unit = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], dim=-1)
    unit[0], unit[-1] = unit.new_tensor([0.0, 0.0, 1.0]), unit.new_tensor([0.0, 0.0, -1.0])
    vertices = unit.reshape(-1, 3) * radius + unit.new_tensor(centre)
    triangles = _grid_triangles(rings + 1, 2 * rings, wrap=True)
    return make_mesh(vertices, triangles, albedo, "sphere")


def make_columns(
    count: int, spacing: float, radius: float, height: float, albedo: Colour = STONE, sides: int = 48
) -> Mesh:
    """A row of upright columns along x, in the middle of which is the origin.

    Args:
        count: number of columns.
        spacing: between their axes [m].
        radius, height: of each [m].
        albedo: [1].
        sides: of the prism that stands for a cylinder.

    Raises:
        SceneError: for sizes that are not positive, or no column.
    """
    if count < 1 or min(spacing, radius, height) <= 0.0 or sides < 3:
        raise SceneError("columns: expected at least one, of positive spacing, radius and height")
    angle = torch.arange(sides, dtype=torch.float64) * 2.0 * math.pi / sides
    rim = torch.stack([angle.cos() * radius, angle.sin() * radius, torch.zeros_like(angle)], dim=1)
    top = torch.tensor([0.0, 0.0, height], dtype=torch.float64)
    one = torch.cat([rim, rim + top, top[None]])
    i, j = torch.arange(sides), (torch.arange(sides) + 1) % sides
    side = torch.cat([torch.stack([i, j, i + sides], 1), torch.stack([j, j + sides, i + sides], 1)])
    lid = torch.stack([i + sides, j + sides, torch.full_like(i, 2 * sides)], 1)
    parts = []
    for number in range(count):
        x = (number - 0.5 * (count - 1)) * spacing
        shifted = one + one.new_tensor([x, 0.0, 0.0])
        parts.append(make_mesh(shifted, torch.cat([side, lid]), albedo, "column"))
    return join_meshes(parts, "columns")


def make_window(
    width: float,
    height: float,
    panes: tuple[int, int],
    bar: float,
    wall: tuple[float, float, float],
    thickness: float,
    albedo: Colour = STONE,
) -> Mesh:
    """A wall in the plane y = 0 with one window in it, divided by bars.

    Args:
        width, height: of the opening [m].
        panes: across and up.
        bar: thickness of the bars [m].
        wall: how far the wall reaches from the opening: to either side, below, above [m].
        thickness: of wall and bars along y [m].
        albedo: [1].

    Returns:
        The wall; its lower edge is at height 0, and the middle of the opening at x = 0.

    Raises:
        SceneError: for sizes that are not positive, or bars that leave no opening.
    """
    across, up = panes
    if min(across, up) < 1 or min(width, height, bar, thickness, *wall) <= 0.0:
        raise SceneError("window: expected at least one pane and positive sizes")
    if bar * (across - 1) >= width or bar * (up - 1) >= height:
        raise SceneError("window: the bars leave no opening")
    side, below, above = wall
    left, right, low, high = -0.5 * width, 0.5 * width, below, below + height
    y0, y1 = -0.5 * thickness, 0.5 * thickness
    boxes = [
        make_box((left - side, y0, 0.0), (left, y1, high + above), albedo),
        make_box((right, y0, 0.0), (right + side, y1, high + above), albedo),
        make_box((left, y0, 0.0), (right, y1, low), albedo),
        make_box((left, y0, high), (right, y1, high + above), albedo),
    ]
    for n in range(1, across):
        x = left + n * width / across
        boxes.append(make_box((x - 0.5 * bar, y0, low), (x + 0.5 * bar, y1, high), albedo))
    for n in range(1, up):
        z = low + n * height / up
        boxes.append(make_box((left, y0, z - 0.5 * bar), (right, y1, z + 0.5 * bar), albedo))
    return join_meshes(boxes, "window")


def make_height_field(heights: Tensor, lower: tuple[float, float], spacing: float, albedo: Colour = GRASS) -> Mesh:
    """Terrain from heights on a grid.

    Args:
        heights: `(y, x)` [m], at least 2 by 2.
        lower: x and y of the first height [m].
        spacing: of the grid [m], positive.
        albedo: [1].

    Raises:
        SceneError: for another shape, a spacing that is not positive, or heights that are not finite.
    """
    if heights.ndim != 2 or min(heights.shape) < 2 or not 0.0 < spacing < math.inf:
        raise SceneError(
            f"terrain: expected at least 2 x 2 heights and a positive spacing, got {tuple(heights.shape)}, {spacing} m"
        )
    rows, columns = heights.shape
    y, x = torch.meshgrid(
        lower[1] + spacing * torch.arange(rows, dtype=torch.float64),
        lower[0] + spacing * torch.arange(columns, dtype=torch.float64),
        indexing="ij",
    )
    vertices = torch.stack([x, y, heights.double()], dim=-1).reshape(-1, 3)
    return make_mesh(vertices, _grid_triangles(rows, columns, wrap=False), albedo, "terrain")


def make_ridge(
    length: float, width: float, height: float, samples: int = 256, peaks: int = 5, seed: int = 3, albedo: Colour = ROCK
) -> Mesh:
    """A jagged range of mountains along x, in the middle of which is the origin: sums of waves that a seed chooses.

    Args:
        length, width: of the terrain along x and y [m].
        height: of the highest summit [m].
        samples: of the grid along the length.
        peaks: number of summits, roughly.
        seed: of the waves.
        albedo: [1].

    Raises:
        SceneError: for sizes that are not positive.
    """
    if min(length, width, height) <= 0.0 or samples < 2 or peaks < 1:
        raise SceneError("ridge: expected positive sizes, at least 2 samples and one peak")
    spacing = length / (samples - 1)
    rows = max(2, round(width / spacing) + 1)
    x = torch.linspace(-0.5, 0.5, samples, dtype=torch.float64)[None]
    y = torch.linspace(-0.5, 0.5, rows, dtype=torch.float64)[:, None]
    generator = torch.Generator().manual_seed(seed)
    relief = torch.zeros(rows, samples, dtype=torch.float64)
    for octave in range(6):
        phase, tilt, lean = torch.rand(3, generator=generator, dtype=torch.float64).tolist()
        frequency = 2.0 * math.pi * peaks * 1.9**octave
        wave = torch.sin(frequency * (x + (lean - 0.5) * y * width / length) + 6.3 * phase)
        across = torch.cos(frequency * 0.8 * y * width / length + 6.3 * tilt)
        relief = relief + 0.55**octave * (1.0 - (wave * (0.7 + 0.3 * across)).abs())
    relief = (relief - relief.min()) / (relief.max() - relief.min())
    profile = (1.0 - (2.0 * y).abs()).clamp(min=0.0) ** 1.3
    return make_height_field(height * profile * (0.35 + 0.65 * relief), (-0.5 * length, -0.5 * width), spacing, albedo)


def make_ground(half_width: float, height: float = 0.0, albedo: Colour = GRASS) -> Mesh:
    """A level square around the origin: two triangles. Raises SceneError for a half width [m] that is not positive."""
    if not 0.0 < half_width < math.inf:
        raise SceneError(f"ground: expected a positive half width, got {half_width} m")
    return make_height_field(
        torch.full((2, 2), height, dtype=torch.float64), (-half_width, -half_width), 2.0 * half_width, albedo
    )


def _grid_triangles(rows: int, columns: int, wrap: bool) -> Tensor:
    """Two triangles for each cell of a grid of vertices, whose last column meets the first if it wraps."""
    last = columns if wrap else columns - 1
    row, column = torch.meshgrid(torch.arange(rows - 1), torch.arange(last), indexing="ij")
    a, b = row * columns + column, row * columns + (column + 1) % columns
    c, d = a + columns, b + columns
    return torch.stack([a, b, d, a, d, c], dim=-1).reshape(-1, 3)
