"""Smooth random numbers in space: lattice values joined by smooth steps, in octaves of half the wavelength and half the size."""

import torch
from torch import Tensor

from render.errors import ParameterError
from render.random_streams import child_generator
from render.trilinear import TrilinearTable

PERIOD = 32
"""Lattice points after which the noise repeats, along each axis."""


class SolidNoise:
    """Noise of mean zero in three dimensions, continuous with its first derivatives, and periodic.

    Args:
        seed: of the noise, not negative.
        octaves: number of wavelengths: 1, 1/2, 1/4... of the unit of length.

    Raises:
        ParameterError: for less than one octave or a negative seed.
    """

    def __init__(self, seed: int, octaves: int = 3) -> None:
        if octaves < 1 or seed < 0:
            raise ParameterError(f"noise needs at least one octave and a seed of at least 0, not {octaves} and {seed}")
        self.octaves = octaves
        self._tables = []
        for octave in range(octaves):
            values = 2.0 * torch.rand(PERIOD, PERIOD, PERIOD, generator=child_generator(seed, octave)) - 1.0
            for axis in range(3):  # the first layer again behind the last, so that no cell needs to wrap
                values = torch.cat([values, values.narrow(axis, 0, 1)], dim=axis)
            self._tables.append(TrilinearTable(values - values[:-1, :-1, :-1].mean()))

    def look_up(self, points: Tensor) -> Tensor:
        """Noise at points.

        Args:
            points: positions `(..., 3)` in units of the longest wavelength.

        Returns:
            Numbers `(...)`, within about -1..1.
        """
        total = torch.zeros_like(points[..., 0], dtype=torch.float32)
        for octave, table in enumerate(self._tables):
            place = torch.remainder(points * 2.0**octave, PERIOD)
            cell = place.floor()
            fraction = place - cell
            x, y, z = (cell + fraction * fraction * (3.0 - 2.0 * fraction)).to(torch.float32).unbind(-1)
            total += 0.5**octave * table.look_up(x, y, z)
        return (total / (2.0 - 0.5 ** (self.octaves - 1))).to(points.dtype)
