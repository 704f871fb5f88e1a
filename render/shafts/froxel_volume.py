"""A volume aligned with the view: light scattered towards the eye and what is let through, summed front to back once.

Each cell (froxel) is the stretch of a camera ray between two distances. With its source J [1/m] (light scattered towards the
eye per length) and its extinction s [1/m] constant within the cell, d metres of it add

    J (1 - exp(-s d)) / s   (J d as s -> 0)

seen through everything before. Many lights then cost one sum of their sources per cell and no march per pixel, and a pixel of
any depth looks up two tables; Tan et al. 2020, "Adaptive volumetric light and atmospheric scattering", figure 7, after
Wronski 2014, "Volumetric fog". Between the ends of a cell the tables are interpolated by the same exponential, so a pixel in
the middle of a column has what a ray march with the same cells finds.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.errors import ParameterError
from render.fused import fused_loops_wanted

PIXELS_IN_FLIGHT = 1 << 16
"""Pixels looked up at once: their eight rows of the tables stay near the cache."""


@dataclass(frozen=True, eq=False)
class FroxelVolume:
    """Accumulated tables at the ends of the cells.

    Args:
        edges: distances from the eye, rising from 0 or more `(edge,)` [m].
        in_scattering: light scattered towards the eye before each distance `(edge, height, width, channel)`.
        optical_depth: to each distance `(edge, height, width, channel)`; one channel stands for all.
    """

    edges: Tensor
    in_scattering: Tensor
    optical_depth: Tensor


def exponential_edges(near: float, far: float, cells: int) -> Tensor:
    """Distances that grow by a constant factor, so that cells keep their shape.

    Args:
        near, far: first and last distance [m], 0 < near < far.
        cells: number of cells, at least 1; one more reaches from the eye to `near` if the caller puts 0 before.

    Returns:
        Distances `(cells + 1,)` [m].

    Raises:
        ParameterError: for distances or a number outside these bounds.
    """
    if not (0.0 < near < far < math.inf and cells >= 1):
        raise ParameterError(f"cells need 0 < near < far and at least one cell, not {near} m, {far} m and {cells}")
    share = torch.arange(cells + 1, dtype=torch.float64) / cells
    edges = near * torch.exp(share * math.log(far / near))
    edges[-1] = far
    return edges.to(torch.float32)


def accumulate_froxels(edges: Tensor, source: Tensor, extinction: Tensor) -> FroxelVolume:
    """Sum cells front to back.

    Args:
        edges: distances from the eye at which cells begin and end, rising `(cell + 1,)` [m].
        source: light scattered towards the eye per length `(cell, height, width, channel)` [1/m].
        extinction: of the cells, not negative `(cell, height, width, channel)` [1/m]; one channel stands for all.

    Returns:
        The tables; summed in float64.

    Raises:
        ParameterError: for shapes that do not belong together, distances that do not rise, or an extinction that is
            negative or not finite, or makes the optical depth so.
    """
    cells = len(edges) - 1
    fits = source.ndim == 4 and source.shape[0] == cells >= 1 and source.shape[:3] == extinction.shape[:3]
    if not fits or extinction.ndim != 4 or extinction.shape[3] not in (1, source.shape[3]):
        raise ParameterError(
            f"{cells} cells need a source (cell, height, width, channel) and an extinction of the same shape or one "
            f"channel, not {tuple(source.shape)} and {tuple(extinction.shape)}"
        )
    if not bool((edges.diff() > 0.0).all()) or float(edges[0]) < 0.0:
        raise ParameterError(f"the distances of cells must rise from 0 m or more, not {edges.tolist()}")
    if not bool((torch.isfinite(extinction) & (extinction >= 0.0)).all()):
        raise ParameterError("the extinction of every cell must be finite and not negative")
    in_scattering = source.new_zeros(cells + 1, *source.shape[1:])
    optical_depth = extinction.new_zeros(cells + 1, *extinction.shape[1:])
    light, depth = in_scattering[0].double(), optical_depth[0].double()
    for cell, length in enumerate(edges.double().diff().tolist()):
        step = extinction[cell].double() * length
        light = light + source[cell] * (length * torch.exp(-depth) * mean_transmittance(step))
        depth = depth + step
        in_scattering[cell + 1], optical_depth[cell + 1] = light, depth
    if not bool(torch.isfinite(optical_depth[-1]).all()):
        raise ParameterError("the optical depth of the cells exceeds the largest number of its precision")
    return FroxelVolume(edges, in_scattering, optical_depth)


def mean_transmittance(optical_depth: Tensor) -> Tensor:
    """Mean of exp(-t) over 0..optical depth: (1 - exp(-x)) / x, and 1 for no depth at all."""
    empty = optical_depth == 0.0
    return torch.where(empty, 1.0, -torch.expm1(-optical_depth) / torch.where(empty, 1.0, optical_depth))


def look_up_froxels(volume: FroxelVolume, columns: Tensor, rows: Tensor, distance: Tensor) -> tuple[Tensor, Tensor]:
    """Light and transmittance between the eye and surfaces.

    Args:
        volume: the tables.
        columns, rows: where the pixels lie in the volume `(pixel,)`, in cells, 0.5 in the middle of the first; the tables are
            interpolated linearly between the middles of columns and held beyond the outer ones.
        distance: from the eye to the surface `(pixel,)` [m], at least 0, infinite for the sky. Nothing lies before the first and
            behind the last distance of the cells.

    Returns:
        Light scattered towards the eye `(pixel, channel)` and transmittance `(pixel, channel)`, one channel for a volume
        of one channel of extinction.

    Raises:
        ParameterError: for NaN or negative distances, or shapes that differ.
    """
    if not columns.shape == rows.shape == distance.shape or distance.ndim != 1 or not bool((distance >= 0.0).all()):
        raise ParameterError("look-ups need one column, row and distance of at least 0 m each for every pixel")
    tensors = (volume.edges, volume.in_scattering, volume.optical_depth, columns, rows, distance)
    if all(tensor.dtype == torch.float32 for tensor in tensors) and fused_loops_wanted(*tensors):
        from render.shafts.fused_froxel_volume import look_up_pixels  # needs numba

        return look_up_pixels(*tensors)
    light = volume.in_scattering.new_empty(len(distance), volume.in_scattering.shape[3])
    through = volume.optical_depth.new_empty(len(distance), volume.optical_depth.shape[3])
    for first in range(0, len(distance), PIXELS_IN_FLIGHT):
        part = slice(first, first + PIXELS_IN_FLIGHT)
        light[part], through[part] = _look_up(volume, columns[part], rows[part], distance[part])
    return light, through


def _look_up(volume: FroxelVolume, columns: Tensor, rows: Tensor, distance: Tensor) -> tuple[Tensor, Tensor]:
    edges = volume.edges.to(distance)
    held = distance.clamp(float(edges[0]), float(edges[-1]))
    cell = (torch.searchsorted(edges, held, right=True) - 1).clamp(0, len(edges) - 2)
    fraction = ((held - edges[cell]) / (edges[cell + 1] - edges[cell]))[:, None]
    _, height, width, channels = volume.in_scattering.shape
    lights = volume.in_scattering.reshape(-1, channels)
    depths = volume.optical_depth.reshape(-1, volume.optical_depth.shape[3])
    before, depth = (table.new_zeros(len(distance), table.shape[1]) for table in (lights, depths))
    after, end = torch.zeros_like(before), torch.zeros_like(depth)
    for column, row, weight in _corners(columns, rows, width, height):
        place = (cell * height + row) * width + column
        for total, table, shift in ((before, lights, 0), (after, lights, 1), (depth, depths, 0), (end, depths, 1)):
            total += weight[:, None] * table.index_select(0, place + shift * height * width)
    passed = fraction * (end - depth)
    # Part of the light of the cell that its first part sends: (1 - exp(-f x)) / (1 - exp(-x)).
    share = fraction * mean_transmittance(passed) / mean_transmittance(end - depth)
    return torch.lerp(before, after, share.expand_as(before)), torch.exp(-(depth + passed))


def _corners(columns: Tensor, rows: Tensor, width: int, height: int) -> list[tuple[Tensor, Tensor, Tensor]]:
    """Column, row and weight of the four columns of cells around each pixel."""
    x, y = (columns - 0.5).clamp(0.0, width - 1.0), (rows - 0.5).clamp(0.0, height - 1.0)
    left, top = x.floor().long(), y.floor().long()
    right, bottom = (left + 1).clamp(max=width - 1), (top + 1).clamp(max=height - 1)
    across, down = x - left, y - top
    return [
        (left, top, (1.0 - across) * (1.0 - down)),
        (right, top, across * (1.0 - down)),
        (left, bottom, (1.0 - across) * down),
        (right, bottom, across * down),
    ]
