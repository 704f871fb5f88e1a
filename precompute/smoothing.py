"""Smoothing the source over neighbouring points, as far as noise exceeds the error that smoothing makes.

Light scattered often varies over the volume like a solution of the diffusion equation: nearly linear from point to point, so an average
over neighbours changes it little while it cuts the noise. The average is the B3 spline [1 4 6 4 1]/16 along each axis, once per level and
with twice the spacing each time (a starlet transform: Starck, Murtagh & Bertero 2015, "Starlet transform in astronomical data
processing"), weighted with the points' numbers of paths. How far to go is decided for each image by two independent halves A and B of the
paths (Rousselle, Knaus & Zwicker 2012, "Adaptive rendering with non-local means filtering"): with A' and B' their smoothed images

    noise^2 = mean (A' - B')^2 / 4,        bias^2 = mean (A' - A)(B' - B),

the noise of A and B drops out of the second on average since they have none in common. With few paths it still hides a bias of a per
cent: where it does, the change from the first level instead of from none tells it, which is far quieter (`bias_of`). The level with
the smallest sum is taken.
What is smoothed is not the source itself but its difference from a model, see `source_model`, which each half fits for itself.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from precompute.gather import Lattice

SPLINE = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)

LEVELS = 3
"""Of smoothing; the last one averages over some thousand neighbours."""

VARIANCES = (0.0, 1.0, 5.0, 21.0, math.inf)
"""Of the averages of each level, in squared spacings; the last is the model alone. What an average changes in smooth light goes with it."""


Taps = tuple[tuple[Tensor, Tensor], ...]
"""For each axis the neighbours of the points and their weights."""


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Which source points are averaged.

    Args:
        axes: for each level and axis, the point's neighbours among the points `(point, tap)` int32 and their weights, zero for
            neighbours that are no source points `(point, tap)`.
        paths: of each point, the weight of its value `(point, 1)`.
    """

    axes: tuple[Taps, ...]
    paths: Tensor

    def levels(self, source: Tensor, expected: Tensor) -> Iterator[Tensor]:
        """The source, then its difference from what is expected ever more smoothed, then what is expected; all `(point, column)`."""
        yield source
        weighted = (source - expected) * self.paths
        for axes, weight in zip(self.axes, self._weights, strict=True):
            weighted = _smooth(axes, weighted)
            yield expected + weighted / weight
        yield expected

    @cached_property
    def _weights(self) -> list[Tensor]:
        """Of the points at each level `(point, 1)`, which all columns share."""
        return list(accumulate(self.axes, lambda weight, axes: _smooth(axes, weight), initial=self.paths))[1:]


def _smooth(axes: Taps, values: Tensor) -> Tensor:
    """Values `(point, column)` averaged along one axis after the other."""
    for neighbours, taps in axes:
        values = embedding_bag(neighbours, values, per_sample_weights=taps, mode="sum")
    return values


def find_neighbours(lattice: Lattice, numbers: Tensor, paths: Tensor) -> Neighbourhood:
    """Neighbours of source points.

    Args:
        lattice: of the points.
        numbers: of the lattice points that are source points `(point,)`.
        paths: traced from each `(point,)`.
    """
    entry = torch.full((lattice.size,), -1, dtype=torch.int32)
    entry[numbers] = torch.arange(len(numbers), dtype=torch.int32)
    counts = lattice.counts
    strides = (1, counts[0], counts[0] * counts[1])
    places = (numbers % counts[0], numbers // counts[0] % counts[1], numbers // strides[2])
    levels = []
    for level in range(LEVELS):
        offsets = torch.arange(-2, 3) << level
        axes = []
        for place, stride, count in zip(places, strides, counts, strict=True):
            within = (place[:, None] + offsets >= 0) & (place[:, None] + offsets < count)
            reached = entry[torch.where(within, numbers[:, None] + offsets * stride, numbers[:, None])]
            taps = torch.where(within & (reached >= 0), torch.tensor(SPLINE), 0.0)
            axes.append((reached.clamp(min=0), taps))
        levels.append(tuple(axes))
    return Neighbourhood(tuple(levels), paths.to(torch.float32)[:, None])


@dataclass(frozen=True, eq=False)
class LevelErrors:
    """Mean squares over pixels.

    Args:
        noise: of the smoothed images.
        bias: that smoothing made; an estimate, which may be negative.
    """

    noise: Tensor
    bias: Tensor

    @classmethod
    def of(cls, smooth: Tensor, change: Tensor, steady: Tensor) -> "LevelErrors":
        """Errors of smoothed images, which changed from the raw ones; see `steady_changes`; all `(pixel, half, ...)`."""
        smooth = smooth.double()
        noise = (smooth[:, 0] - smooth[:, 1]).square().mean(0) / 4.0
        return cls(noise, bias_of(change.double(), steady.double()))

    @property
    def total(self) -> Tensor:
        """Squared error."""
        return self.noise + self.bias.clamp(min=0.0)


def bias_of(change: Tensor, steady: Tensor) -> Tensor:
    """Mean square of what smoothing changed `(...)`, told from the changes of both halves.

    The mean of their product is right on average. That of the steady changes is quieter, and too small where light is rough; it is taken as
    far as it lies within a deviation above the other one and two below: neighbouring pixels see the same points.

    Args:
        change: from the raw images `(pixel, half, ...)`.
        steady: the same told otherwise, see `steady_changes`.
    """
    products = change[:, 0] * change[:, 1]
    exact, quiet = products.mean(0), (steady[:, 0] * steady[:, 1]).mean(0)
    deviation = ((products - exact).square().mean(0) / len(products)).sqrt()
    return torch.minimum(torch.maximum(quiet, exact - 2.0 * deviation), exact + deviation)


def steady_changes(images: list[Tensor]) -> list[Tensor]:
    """What each level of smoothing changes in images `(pixel, half, ...)`, told without the raw ones and their noise.

    The change from the first level to another stands for that from the raw image, scaled to the whole variance of the average. Of
    fewer than two levels nothing else is known than the changes themselves.
    """
    if len(images) < 3:
        return [image - images[0] for image in images]
    raw, first, second = images[:3]
    none, small = torch.zeros_like(raw), (second - first) * (VARIANCES[1] / (VARIANCES[2] - VARIANCES[1]))
    scales = [1.0 / (1.0 - VARIANCES[1] / variance) for variance in VARIANCES[2:]]
    return [none, small, *((image - first) * scale for image, scale in zip(images[2:], scales, strict=False))]


def measure_levels(images: list[Tensor]) -> LevelErrors:
    """Errors `(level, ...)` of images `(pixel, half, ...)` at every level, the first one without smoothing."""
    steady = steady_changes(images)
    errors = [LevelErrors.of(image, image - images[0], one) for image, one in zip(images, steady, strict=True)]
    return LevelErrors(torch.stack([one.noise for one in errors]), torch.stack([one.bias for one in errors]))
