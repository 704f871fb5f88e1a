"""What the in-scattered source at a point should be, judging by what lies around it: a linear model that has no noise of its own.

Light comes to a point from the sun and, scattered, from where the cloud around it is thin. So the source is fitted, column by column,
with functions of the optical lengths u from the point to the border of the volume: towards the sun, towards the camera and in 14
directions all around, as exp(-c s u) for several shares c of the extinction s, their means, products and moments along the sun, and with
the point's place.
Feature-based regression of rendered light goes back to Moon, Carr & Yoon 2014, "Adaptive rendering based on weighted local
regression"; here one regression serves the whole volume, and smoothing is left the part that it does not explain.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.camera import Camera
from render.density_grid import DensityGrid
from render.free_flight import fly

MARCHING_STEP = 1.0
"""In voxels, of the optical lengths."""

SHARES = (1.0, 0.3, 0.1, 0.03)
"""Of the extinction: light that is scattered forward or often reaches farther than the direct beam."""

DIRECTIONAL_SHARES = (0.3, 0.1)
"""Shares for which every direction has a feature of its own."""

RIDGE = 1e-7
"""Added to the normal equations, relative to their diagonal: in thin clouds many features are nearly the same."""

ROWS = 16_384
"""Points whose sources are held at a time in double precision, for which all of them would take too much memory."""

EMPTY = 1e-12
"""Share of the largest square sum below which a feature is nothing but rounding: it may be zero everywhere, and still needs a ridge."""

POINTS_PER_FEATURE = 30
"""Fewer points than this for each feature, and the model is only the mean."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Optical lengths from source points to the border of the volume.

    Args:
        sun: towards the sun `(point,)` [m].
        camera: towards the camera `(point,)` [m].
        around: in fixed directions `(point, direction)` [m].
        cosine: of these directions with the sun's `(direction,)`.
        place: coordinates, each of mean zero and variance one `(point, 3)`.
    """

    sun: Tensor
    camera: Tensor
    around: Tensor
    cosine: Tensor
    place: Tensor

    def features(self, extinction: float) -> Tensor:
        """Features at one extinction [1/m] `(point, feature)`; the first is one."""
        one = torch.ones_like(self.sun)[:, None]
        if len(one) < POINTS_PER_FEATURE * FEATURES:
            return one
        shares = torch.tensor(SHARES)
        sun, camera = (torch.exp(-extinction * length[:, None] * shares) for length in (self.sun, self.camera))
        around = torch.exp(-extinction * self.around[:, :, None] * shares)
        mean, moment = around.mean(1), (self.cosine[:, None] * around).mean(1)
        brightest = around[:, :, 1:].amax(1)
        directional = around[:, :, 1 : 1 + len(DIRECTIONAL_SHARES)].flatten(1)
        products = (sun[:, :, None] * mean[:, None, :3]).flatten(1)
        return torch.cat(
            [one, sun, camera, mean, brightest, moment, directional, self.place, self.place**2, products], dim=1
        )


def _fixed_directions() -> Tensor:
    """Unit vectors to the faces and corners of a cube `(direction, 3)`."""
    axes = torch.cat([torch.eye(3), -torch.eye(3)])
    signs = torch.tensor([1.0, -1.0])
    return torch.cat([axes, torch.cartesian_prod(signs, signs, signs) / math.sqrt(3.0)])


DIRECTIONS = _fixed_directions()

FEATURES = 1 + 4 * len(SHARES) + 3 + len(DIRECTIONAL_SHARES) * len(DIRECTIONS) + 6 + 3 * len(SHARES)


def measure_surroundings(grid: DensityGrid, camera: Camera, sun: Tensor, position: Tensor) -> Surroundings:
    """March from source points to the border of the volume.

    Args:
        grid: the volume.
        camera: of the view.
        sun: unit vector towards the sun `(3,)`.
        position: of the points `(point, 3)` [m].
    """
    endless = torch.tensor(math.inf)

    def march(direction: Tensor) -> Tensor:
        target = endless.expand(len(position))
        return fly(grid, position, direction.expand_as(position).contiguous(), target, MARCHING_STEP).optical_length

    centred = position - position.mean(0)
    return Surroundings(
        march(sun),
        march(-camera.directions_at(position)),
        torch.stack([march(direction) for direction in DIRECTIONS], dim=1),
        DIRECTIONS @ sun,
        centred / centred.square().mean(0).sqrt().clamp(min=1e-30),
    )


class SourceModel:
    """Weighted least squares on fixed features, for any number of columns.

    Args:
        features: of the points `(point, feature)`.
        paths: traced from each point, the inverse of its variance but for a factor `(point,)`.
    """

    def __init__(self, features: Tensor, paths: Tensor) -> None:
        self._features = [part.double() for part in features.split(ROWS)]
        self._paths = paths[:, None].split(ROWS)
        normal = self._moments(features)
        diagonal = normal.diagonal()
        diagonal.add_(RIDGE * diagonal.clamp(min=EMPTY * float(diagonal.max())))
        self._factor = torch.linalg.cholesky_ex(normal).L

    def expect(self, source: Tensor) -> Tensor:
        """Values of the model `(point, column)` fitted to noisy ones."""
        coefficients = torch.cholesky_solve(self._moments(source), self._factor)
        return torch.cat([(part @ coefficients).to(source.dtype) for part in self._features])

    def _moments(self, values: Tensor) -> Tensor:
        """Weighted sums over the points of features times values `(feature, column)`, float64.

        The normal equations square the condition number: in float32 half of the features would be lost.
        """
        parts = zip(self._features, values.split(ROWS), self._paths, strict=True)
        return torch.stack([features.T @ (value.double() * paths) for features, value, paths in parts]).sum(0)
