"""A seeded cumulus: spheroids heaped on a flat base, puffs on their surfaces, billows raised by cellular noise.

The shape is a field, positive inside the cloud: the largest depth below the surface of any spheroid, displaced by the
billows and cut by the base. Lengths are fractions of the width of the cloud until the grid is made. The field depends on
the seed alone; the resolution only decides how finely it is sampled.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.random_streams import child_generator
from render.trilinear import TrilinearTable

SMALLEST_RESOLUTION = 8
LARGEST_RESOLUTION = 1024

# Stages of the random streams: a stage keeps its numbers when another draws more.
_HEAP, _PUFFS, _BILLOWS, _BASE, _RIM, _CORE = range(6)

# Puffs on each parent, and the range of their radii as fractions of its radius.
_PUFF_GENERATIONS = ((16, 0.30, 0.55), (12, 0.28, 0.50))

# Wavelength and amplitude of the rounded bumps on the surface.
_BILLOW_OCTAVES = ((0.110, 0.028), (0.055, 0.017), (0.0275, 0.009), (0.0138, 0.005))
_BILLOW_REACH = sum(amplitude for _, amplitude in _BILLOW_OCTAVES)

# A rim is crisp where the cloud grows and frayed where it evaporates: softness varies by these factors.
_RIM_FACTORS = (0.4, 2.5)

# A parcel gains liquid water as it rises (adiabatic ascent), so the core is thinner at the base than at the top.
_DENSITY_AT_BASE = 0.55

_ELEMENTS_IN_FLIGHT = 1 << 18


@dataclass(frozen=True, eq=False)
class _Spheroids:
    """Spheres heaped on the plane z = 0: centres `(spheroid, 3)` x, y, z and radii `(spheroid,)`."""

    centres: Tensor
    radii: Tensor

    def joined(self, others: "_Spheroids") -> "_Spheroids":
        return _Spheroids(torch.cat([self.centres, others.centres]), torch.cat([self.radii, others.radii]))

    def depth(self, points: Tensor) -> Tensor:
        """Largest depth of points `(point, 3)` below a surface, negative outside `(point,)`."""
        chunks = points.split(max(1, _ELEMENTS_IN_FLIGHT // len(self.radii)))
        return torch.cat([(self.radii - torch.cdist(chunk, self.centres)).amax(1) for chunk in chunks])


@dataclass(frozen=True, eq=False)
class _Lattice:
    """Voxel centres: the corner of the box `(3,)`, the edge of a voxel, and the voxel counts along x, y, z."""

    corner: Tensor
    voxel: float
    counts: Tensor

    @property
    def shape(self) -> tuple[int, int, int]:
        x, y, z = (int(count) for count in self.counts)
        return z, y, x

    def points(self, index: Tensor) -> Tensor:
        """Positions `(..., 3)` of voxels with the indices `(..., 3)` x, y, z."""
        return (index + 0.5) * self.voxel + self.corner


def build_cumulus(
    resolution: int, seed: int = 0, *, width: float = 1000.0, towering: float = 0.6, softness: float = 0.012
) -> DensityGrid:
    """Density of a cumulus with billows and a flat base, centred on the origin.

    Args:
        resolution: voxels along the longest side, border included; 8 to 1024.
        seed: of the shape, not negative; the same seed gives the same cloud at every resolution.
        width: extent of the cloud along x, about [m].
        towering: height of the tallest towers over the width, more than 0 and at most 2.
        softness: thickness of the rim over the width, more than 0 and at most 0.2; never thinner than 1.5 voxels.

    Returns:
        Density 0..1 `(z, y, x)` in cubic voxels; the outermost voxels are zero.

    Raises:
        ParameterError: for an argument outside its domain.
    """
    _check_arguments(resolution, seed, width, towering, softness)
    spheroids = _with_unit_width(_grow_puffs(_build_heap(seed, towering), seed))
    lattice = _lattice_around(spheroids, resolution)
    field = _union_depth(spheroids, lattice)
    _raise_billows(field, lattice, seed)
    density = _density_from_field(field, lattice, seed, softness)
    for axis in range(3):
        density.narrow(axis, 0, 1).zero_()
        density.narrow(axis, density.shape[axis] - 1, 1).zero_()
    return DensityGrid.from_voxel_size(density, lattice.voxel * width)


def _check_arguments(resolution: int, seed: int, width: float, towering: float, softness: float) -> None:
    if not SMALLEST_RESOLUTION <= resolution <= LARGEST_RESOLUTION:
        raise ParameterError(
            f"a cloud needs a resolution from {SMALLEST_RESOLUTION} to {LARGEST_RESOLUTION}, not {resolution}"
        )
    if seed < 0:
        raise ParameterError(f"the seed of a cloud must not be negative, but is {seed}")
    if not (math.isfinite(width) and width > 0):
        raise ParameterError(f"the width of a cloud should be a positive length [m], not {width}")
    if not 0 < towering <= 2:
        raise ParameterError(f"towering should be more than 0 and at most 2, not {towering}")
    if not 0 < softness <= 0.2:
        raise ParameterError(f"softness should be more than 0 and at most 0.2, not {softness}")


def _uniform(generator: torch.Generator, low: float, high: float, *shape: int) -> Tensor:
    return low + (high - low) * torch.rand(shape, generator=generator)


def _build_heap(seed: int, towering: float) -> _Spheroids:
    """The big spheroids: low ones that make the base, and leaning columns that make the towers."""
    generator = child_generator(seed, _HEAP)
    low_ones, towers, storeys = 9, 4, 4
    golden_angle = math.pi * (3.0 - math.sqrt(5.0))  # even around the middle, without a pattern
    azimuth = _uniform(generator, 0.0, 2.0 * math.pi, 1) + golden_angle * torch.arange(low_ones)
    distance = 0.36 * torch.sqrt((torch.arange(low_ones) + _uniform(generator, 0.2, 0.8, low_ones)) / low_ones)
    radius = _uniform(generator, 0.13, 0.18, low_ones) * (1.15 - distance)
    centre = torch.stack([distance * torch.cos(azimuth), 0.7 * distance * torch.sin(azimuth), 0.45 * radius], dim=1)
    heap = _Spheroids(centre, radius)
    height = torch.linspace(0.2, 1.0, storeys)
    for _ in range(towers):
        top = towering * float(_uniform(generator, 0.45, 1.0, 1))
        foot, lean = _uniform(generator, -0.2, 0.2, 2), _uniform(generator, -0.1, 0.1, 2)
        radius = 0.17 * (1.0 - 0.4 * height) * _uniform(generator, 0.85, 1.15, storeys)
        across = foot + lean * height[:, None] + 0.03 * torch.randn(storeys, 2, generator=generator)
        up = height * max(top - float(radius[-1]), 0.0)
        heap = heap.joined(_Spheroids(torch.cat([across, up[:, None]], dim=1), radius))
    return heap


def _grow_puffs(heap: _Spheroids, seed: int) -> _Spheroids:
    """Smaller spheroids on the surfaces of the last generation, mostly upwards, where they are not buried."""
    everything, parents = heap, heap
    for generation, (count, smallest, largest) in enumerate(_PUFF_GENERATIONS):
        generator = child_generator(seed, _PUFFS, generation)
        number = count * len(parents.radii)
        direction = torch.nn.functional.normalize(torch.randn(number, 3, generator=generator), dim=1)
        upwards = torch.where(torch.rand(number, generator=generator) < 0.8, 1.0, -1.0)
        direction[:, 2] = direction[:, 2].abs() * upwards
        parent_radius = parents.radii.repeat_interleave(count)
        radius = parent_radius * _uniform(generator, smallest, largest, number)
        centre = parents.centres.repeat_interleave(count, dim=0) + 0.92 * parent_radius[:, None] * direction
        seen = (everything.depth(centre) < 0.8 * radius) & (centre[:, 2] > 0.0)
        parents = _Spheroids(centre[seen], radius[seen])
        everything = everything.joined(parents)
    return everything


def _with_unit_width(spheroids: _Spheroids) -> _Spheroids:
    width = (spheroids.centres[:, 0] + spheroids.radii).max() - (spheroids.centres[:, 0] - spheroids.radii).min()
    return _Spheroids(spheroids.centres / width, spheroids.radii / width)


def _lattice_around(spheroids: _Spheroids, resolution: int) -> _Lattice:
    """Box around everything above the base, with room for the billows and for a border of empty voxels."""
    low = (spheroids.centres - spheroids.radii[:, None]).amin(0) - 0.5 * _BILLOW_REACH
    high = (spheroids.centres + spheroids.radii[:, None]).amax(0) + 0.5 * _BILLOW_REACH
    low[2] = 0.0
    border = 2
    voxel = float((high - low).max()) / (resolution - border)
    counts = torch.ceil((high - low) / voxel - 1e-3).long() + border
    return _Lattice(0.5 * (low + high) - 0.5 * counts * voxel, voxel, counts)


def _union_depth(spheroids: _Spheroids, lattice: _Lattice) -> Tensor:
    """Largest depth below any surface `(z, y, x)`; far outside a constant that the billows do not reach."""
    z, y, x = lattice.shape
    field = torch.full((z * y * x,), -2.0 * _BILLOW_REACH)
    for chunk, offsets in _stencils(spheroids.radii + _BILLOW_REACH, lattice.voxel):
        centre = spheroids.centres[chunk]
        nearest = torch.floor((centre - lattice.corner) / lattice.voxel).long()
        index = nearest[:, None, :] + offsets
        owner, inside = torch.nonzero(((index >= 0) & (index < lattice.counts)).all(-1), as_tuple=True)
        index = index[owner, inside]
        depth = spheroids.radii[chunk][owner] - torch.linalg.vector_norm(lattice.points(index) - centre[owner], dim=1)
        flat = (index[:, 2] * y + index[:, 1]) * x + index[:, 0]
        field.scatter_reduce_(0, flat, depth, "amax")
    return field.reshape(z, y, x)


def _stencils(reach: Tensor, voxel: float) -> Iterator[tuple[Tensor, Tensor]]:
    """Chunks of spheroids of similar reach `(spheroid,)` and the voxel offsets `(offset, 3)` that cover each of them."""
    cells = torch.ceil(reach / voxel).long()
    for radius in cells.unique().tolist():
        side = torch.arange(-radius, radius + 1)
        offsets = torch.cartesian_prod(side, side, side)
        offsets = offsets[offsets.square().sum(1) <= (radius + 1) ** 2]
        members = torch.nonzero(cells == radius)[:, 0]
        for chunk in members.split(max(1, _ELEMENTS_IN_FLIGHT // len(offsets))):
            yield chunk, offsets


def _raise_billows(field: Tensor, lattice: _Lattice, seed: int) -> None:
    """Displace the surface by bumps of falling wavelength, down to the finest that the voxels can show."""
    shell = torch.nonzero((field > -_BILLOW_REACH) & (field < 2.0 * _BILLOW_REACH))
    for chunk in shell.split(_ELEMENTS_IN_FLIGHT):
        points = lattice.points(chunk.flip(1))
        displacement = torch.zeros(len(points))
        for octave, (wavelength, amplitude) in enumerate(_BILLOW_OCTAVES):
            if wavelength >= 2.0 * lattice.voxel:
                displacement += amplitude * _look_up_bumps(points / wavelength, seed, octave)
        field[tuple(chunk.unbind(1))] += displacement


def _look_up_bumps(points: Tensor, seed: int, octave: int) -> Tensor:
    """Rounded bumps with creases between them (Worley 1996, the distance to the nearest feature), mean about zero.

    Features keep 0.2 away from the faces of their cells and distances end at 0.7: no feature beyond the eight nearest
    cells can be closer than that, so that eight suffice.
    """
    period, margin, farthest, mean = 64, 0.2, 0.7, 0.492
    generator = child_generator(seed, _BILLOWS, octave)
    features = _uniform(generator, margin, 1.0 - margin, period**3, 3)
    # Turned cells show no rows along the axes.
    points = points @ torch.linalg.qr(torch.randn(3, 3, generator=generator)).Q
    first = torch.floor(points - 0.5)
    square = torch.full((len(points),), farthest**2)
    for corner in torch.cartesian_prod(*[torch.arange(2)] * 3):
        cell = first + corner
        x, y, z = (cell.long() % period).unbind(1)
        feature = features[(z * period + y) * period + x] + cell
        square = torch.minimum(square, (feature - points).square().sum(1))
    return mean - square.sqrt()


def _look_up_patches(points: Tensor, wavelength: float, seed: int, stage: int) -> Tensor:
    """Smooth random numbers 0..1 that vary over a wavelength, at points `(point, 3)`."""
    period = math.ceil(2.5 / wavelength)  # covers two widths and a half; beyond that the outermost value is held
    values = torch.rand(period, period, period, generator=child_generator(seed, stage))
    x, y, z = (points / wavelength + 0.5 * period).unbind(-1)
    return TrilinearTable(values).look_up(x, y, z)


def _density_from_field(field: Tensor, lattice: _Lattice, seed: int, softness: float) -> Tensor:
    density = torch.zeros_like(field)
    inside = torch.nonzero(field > -softness)
    for chunk in inside.split(_ELEMENTS_IN_FLIGHT):
        points = lattice.points(chunk.flip(1))
        depth = field[tuple(chunk.unbind(1))]
        base = 0.02 * _look_up_patches(points * torch.tensor([1.0, 1.0, 0.0]), 0.07, seed, _BASE)
        depth = _smooth_minimum(depth, points[:, 2] - base, 0.04)
        frayed = _look_up_patches(points, 0.15, seed, _RIM).square()
        rim = softness * (_RIM_FACTORS[0] + (_RIM_FACTORS[1] - _RIM_FACTORS[0]) * frayed)
        # The surface of half density stays where it is when a coarse grid widens the rim.
        rise = 0.5 + (depth - 0.5 * rim) / rim.clamp(min=1.5 * lattice.voxel)
        ascent = (points[:, 2] / 0.5).clamp(0.0, 1.0)
        core = _DENSITY_AT_BASE + (1.0 - _DENSITY_AT_BASE) * ascent
        core = core * (0.85 + 0.15 * _look_up_patches(points, 0.06, seed, _CORE))
        density[tuple(chunk.unbind(1))] = core * _smooth_step(rise)
    return density


def _smooth_minimum(first: Tensor, second: Tensor, width: float) -> Tensor:
    """Minimum whose edge is rounded over `width`; never above either."""
    overlap = (width - (first - second).abs()).clamp(min=0.0)
    return torch.minimum(first, second) - overlap.square() / (4.0 * width)


def _smooth_step(rise: Tensor) -> Tensor:
    rise = rise.clamp(0.0, 1.0)
    return rise * rise * (3.0 - 2.0 * rise)
