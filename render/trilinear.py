"""Trilinear interpolation of a scalar table, the one look-up that every volume in the project shares."""

from functools import cached_property

import torch
from torch import Tensor

from render.empty_space import measure_clearance
from render.errors import ParameterError
from render.fused import fused_loops_wanted

CORNER_TABLE_VOXELS = 16_000_000
"""Up to this many voxels the eight corners of each cell are stored side by side: one cache line a look-up, eight times the
memory, about twice the speed of eight gathers. Larger tables are gathered corner by corner."""

LOOK_UP_CHUNK = 65_536
"""Points in flight at once: their intermediate rows stay within the cache."""


class TrilinearTable:
    """Values at integer coordinates (z, y, x), interpolated linearly along each axis and held constant outside.

    Args:
        values: table `(z, y, x)`, float32 or float64.

    Raises:
        ParameterError: if the table is not three-dimensional or has an axis of length zero.
    """

    def __init__(self, values: Tensor) -> None:
        if values.ndim != 3 or values.numel() == 0:
            raise ParameterError(
                f"a trilinear table needs the shape (z, y, x) without empty axes, not {tuple(values.shape)}"
            )
        self.values = values.contiguous()

    @cached_property
    def _cells(self) -> tuple[int, int, int]:
        z, y, x = (max(n - 1, 1) for n in self.values.shape)
        return z, y, x

    @cached_property
    def padded(self) -> Tensor:
        """The values with axes of length one doubled, so that every axis has at least one cell."""
        values = self.values
        for axis in range(3):
            if values.shape[axis] == 1:
                values = values.repeat_interleave(2, dim=axis)
        return values.contiguous()

    @cached_property
    def clearance(self) -> Tensor:
        """Cells from each cell of `padded` to the nearest that holds anything, see `measure_clearance`."""
        return measure_clearance(self.padded)

    @cached_property
    def _corner_offsets(self) -> list[int]:
        _, rows, row = self.padded.shape
        return [(dz * rows + dy) * row + dx for dz in (0, 1) for dy in (0, 1) for dx in (0, 1)]

    @cached_property
    def _corner_table(self) -> Tensor | None:
        """The eight corners of each cell as one row `(cell, 8)`, or None where that would take too much memory."""
        if self.values.numel() > CORNER_TABLE_VOXELS:
            return None
        z, y, x = self._cells
        corners = [
            self.padded[dz : dz + z, dy : dy + y, dx : dx + x] for dz in (0, 1) for dy in (0, 1) for dx in (0, 1)
        ]
        return torch.stack(corners, dim=-1).reshape(-1, 8)

    def _corner_rows(self, cell_z: Tensor, cell_y: Tensor, cell_x: Tensor) -> Tensor:
        if self._corner_table is not None:
            _, y, x = self._cells
            return self._corner_table.index_select(0, (cell_z * y + cell_y) * x + cell_x)
        flat = self.padded.reshape(-1)
        _, rows, row = self.padded.shape
        base = (cell_z.long() * rows + cell_y) * row + cell_x
        return torch.stack([flat.index_select(0, base + offset) for offset in self._corner_offsets], dim=-1)

    def look_up(self, x: Tensor, y: Tensor, z: Tensor) -> Tensor:
        """Interpolated values at continuous table coordinates.

        Args:
            x, y, z: coordinates of equal shape, in table steps; 0 is the first sample of the axis.

        Returns:
            Values of the same shape.
        """
        shape = x.shape
        if x.dtype == self.values.dtype == torch.float32 and fused_loops_wanted(self.values, x, y, z):
            from render.fused_trilinear import look_up_trilinear  # needs numba

            flat = (coordinate.reshape(-1).contiguous() for coordinate in (x, y, z))
            return look_up_trilinear(self.padded, *flat).reshape(shape)
        parts = [
            self._look_up_chunk(*chunk)
            for chunk in zip(*(c.reshape(-1).split(LOOK_UP_CHUNK) for c in (x, y, z)), strict=True)
        ]
        return (parts[0] if len(parts) == 1 else torch.cat(parts)).reshape(shape)

    def _look_up_chunk(self, x: Tensor, y: Tensor, z: Tensor) -> Tensor:
        cells_z, cells_y, cells_x = self._cells
        cell_x, fraction_x = _split_coordinate(x, self.values.shape[2], cells_x)
        cell_y, fraction_y = _split_coordinate(y, self.values.shape[1], cells_y)
        cell_z, fraction_z = _split_coordinate(z, self.values.shape[0], cells_z)
        rows = self._corner_rows(cell_z, cell_y, cell_x)
        rows = torch.lerp(rows[:, :4], rows[:, 4:], fraction_z[:, None])
        rows = torch.lerp(rows[:, :2], rows[:, 2:], fraction_y[:, None])
        return torch.lerp(rows[:, 0], rows[:, 1], fraction_x)


def _split_coordinate(coordinate: Tensor, samples: int, cells: int) -> tuple[Tensor, Tensor]:
    """Cell number and fraction within the cell, with coordinates outside held at the first and last sample."""
    held = coordinate.clamp(0.0, float(samples - 1))
    cell = held.int().clamp_(max=cells - 1)
    return cell, held - cell
