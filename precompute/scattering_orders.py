"""Build the scattering stack: optical length, single scattering, and the orders from two upwards on the whole table.

The extinction nodes are treated in groups of similar optical depth. A thin group needs few, widely spaced source points, since light
varies over the whole cloud; a thick one needs points near the surface that the camera sees, closer together than the mean free path
allows anywhere else. Each group has its own lattice, its own marching step and its own set of paths for all of its nodes.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from precompute.gather import Lattice, gather_bags, lattice_over
from precompute.path_sampler import TableNodes
from precompute.single_scattering import compute_single_scattering
from precompute.source_points import SourcePoints, allocate_paths, trace_source
from render.camera import Camera, unit_direction
from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.phase_functions import check_asymmetry, evaluate_phase_function
from render.ray_march import compute_optical_length
from render.scattering_stack import ScatteringTables

Progress = Callable[[str, float], None]

GROUP_EDGES = (2.0, 20.0)
"""Largest optical depths at which a new group of extinction nodes begins."""

STEP_DEPTH = 0.5
"""Optical depth of a marching step in the densest voxel, within the bounds that follow."""

SMALLEST_STEP, LARGEST_STEP = 0.25, 1.0
"""Bounds of the marching step in voxels."""

THICK_SPACING = 0.5
"""Closest lattice in voxels: pixels and density vary over a voxel, not over less."""

SECTIONS_PER_STRATUM = 2
"""Single scattering is cut finer than the source points' strata: it has no noise to hide behind."""

LARGEST_LATTICE = 1 << 24
"""Lattice points that may be numbered, whether or not they are used."""

THINNEST_ANCHOR = 0.5
"""Largest optical depth below which no path is drawn: multiple scattering is a per-cent effect there, and reweighting reaches it."""


@dataclass(frozen=True)
class Effort:
    """How much work a stack is worth.

    Args:
        orders: largest number of scatterings, at least two.
        points: source points of each group, about.
        paths: over all groups, about.
        strata: positions along each camera ray.
    """

    orders: int = 4
    points: int = 120_000
    paths: int = 3_000_000
    strata: int = 16

    def __post_init__(self) -> None:
        if self.orders < 2 or min(self.points, self.paths, self.strata) < 1:
            raise ParameterError(f"a stack needs at least two orders and one point, path and stratum, not {self}")


DEFAULT_EFFORT = Effort()


@dataclass(frozen=True, eq=False)
class _View:
    """The rays that see cloud."""

    grid: DensityGrid
    camera: Camera
    sun: Tensor
    origin: Tensor
    direction: Tensor
    largest_optical_length: float


def build_scattering_stack(
    grid: DensityGrid,
    camera: Camera,
    sun_direction: Tensor,
    asymmetry: Tensor,
    extinction: Tensor,
    effort: Effort = DEFAULT_EFFORT,
    seed: int = 0,
    on_progress: Progress = lambda stage, share: None,
) -> ScatteringTables:
    """Precompute the images of a cloud for every node of the (asymmetry x extinction) table.

    Args:
        grid: the volume.
        camera: the view.
        sun_direction: towards the sun `(3,)`, of any length.
        asymmetry: nodes `(asymmetry,)`, rising, within +-0.999.
        extinction: nodes `(extinction,)` [1/m], rising, positive.
        effort: work to spend.
        seed: of all random streams.
        on_progress: called with a stage's name and the share of it that is done.

    Returns:
        The tables; for a view without cloud they have no pixel.

    Raises:
        ParameterError: for nodes outside their domain, or a sun vector without direction.
    """
    _check_nodes(asymmetry, extinction)
    sun = unit_direction(sun_direction)
    origin, direction = camera.rays()
    optical_length = compute_optical_length(grid, origin, direction)
    pixel = torch.nonzero(optical_length > 0).flatten()
    largest = float(optical_length.max())
    optical_depth = extinction * largest
    view = _View(grid, camera, sun, origin[pixel], direction[pixel], largest)
    parts = []
    groups = _split_groups(optical_depth) if len(pixel) else []
    shares = _path_shares(optical_depth, groups)
    for number, (group, share) in enumerate(zip(groups, shares, strict=True)):
        name = f"optical depth {optical_depth[group][0]:.3g} to {optical_depth[group][-1]:.3g}"
        part_effort = Effort(effort.orders, effort.points, max(1, round(share * effort.paths)), effort.strata)
        report = _stage_reporter(on_progress, name)
        parts.append(_build_group(view, asymmetry, extinction[group], part_effort, seed * 64 + number, report))
    return _assemble(camera, pixel, optical_length, view, asymmetry, extinction, effort.orders, parts)


def _check_nodes(asymmetry: Tensor, extinction: Tensor) -> None:
    check_asymmetry(asymmetry)
    for name, nodes in (("asymmetry", asymmetry), ("extinction", extinction)):
        if nodes.ndim != 1 or len(nodes) == 0 or not bool((nodes.diff() > 0).all()):
            raise ParameterError(f"the {name} nodes must be one or more rising numbers, not {nodes.tolist()}")
    if not bool((extinction > 0).all() & torch.isfinite(extinction).all()):
        raise ParameterError(f"extinction nodes must be positive and finite, not {extinction.tolist()} 1/m")


def _stage_reporter(on_progress: Progress, name: str) -> Callable[[float], None]:
    return lambda share: on_progress(name, share)


def _split_groups(optical_depth: Tensor) -> list[slice]:
    edges = torch.tensor(GROUP_EDGES, dtype=optical_depth.dtype)
    number = torch.bucketize(optical_depth, edges, right=True)
    starts = [0] + [i for i in range(1, len(number)) if number[i] != number[i - 1]]
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(number)], strict=True)]


def _path_shares(optical_depth: Tensor, groups: list[slice]) -> list[float]:
    """Share of the paths for each group: by its number of nodes and by how much light is scattered more than once."""
    weights = [float(-torch.expm1(-optical_depth[group].double() / 10.0).sum()) for group in groups]
    return [weight / sum(weights) for weight in weights]


@dataclass(frozen=True, eq=False)
class _GroupImages:
    single: Tensor
    halves: Tensor
    effective_share: Tensor


def _build_group(
    view: _View,
    asymmetry: Tensor,
    extinction: Tensor,
    effort: Effort,
    seed: int,
    report: Callable[[float], None],
) -> _GroupImages:
    """Single scattering `(extinction, pixel)` and both halves of the orders `(half, order, asymmetry, extinction, pixel)`."""
    voxel_depth = float(extinction[-1]) * view.grid.maximum * float(view.grid.voxel_size.min())
    step = min(max(STEP_DEPTH / voxel_depth, SMALLEST_STEP), LARGEST_STEP)
    sections = SECTIONS_PER_STRATUM * effort.strata
    single = compute_single_scattering(view.grid, view.origin, view.direction, view.sun, extinction, step, sections)
    report(0.1)
    lattice, points = _place_points(view, extinction, effort)
    anchors = extinction[extinction * view.largest_optical_length >= THINNEST_ANCHOR]
    nodes = TableNodes(asymmetry, extinction, asymmetry, anchors if len(anchors) else extinction[-1:])
    table = trace_source(
        view.grid,
        view.camera,
        view.sun,
        lattice,
        points,
        nodes,
        effort.orders,
        step,
        seed,
        lambda share: report(0.1 + 0.8 * share),
    )
    entry = torch.zeros(lattice.size, dtype=torch.int32)
    entry[points.numbers] = torch.arange(len(points.numbers), dtype=torch.int32)
    images = torch.empty(len(extinction), len(view.origin), 2 * (effort.orders - 1) * len(asymmetry))
    for bags in gather_bags(view.grid, lattice, view.origin, view.direction, extinction, effort.strata):
        source = table.source[bags.extinction].flatten(1)
        rows = embedding_bag(entry[bags.numbers], source, per_sample_weights=bags.weights, mode="sum")
        images[bags.extinction, bags.rays] = rows
    report(1.0)
    halves = images.unflatten(2, (2, effort.orders - 1, len(asymmetry))).permute(2, 3, 4, 0, 1)
    return _GroupImages(single, halves, table.effective_share)


def _place_points(view: _View, extinction: Tensor, effort: Effort) -> tuple[Lattice, SourcePoints]:
    """Lattice as fine as the number of points allows, and the paths of each of its points."""
    finest = _finest_stretch(view.grid)
    stretch = max(finest, 1.0)
    for _ in range(3):
        lattice = lattice_over(view.grid, stretch)
        importance = torch.zeros(lattice.size, dtype=torch.float64)
        for bags in gather_bags(view.grid, lattice, view.origin, view.direction, extinction, effort.strata):
            importance.index_add_(0, bags.numbers.flatten(), bags.weights.flatten().double().square())
        used = int((importance > 0).sum())
        wanted = max(finest, stretch * (used / effort.points) ** 0.4)
        if 0.8 < wanted / stretch < 1.25:
            break
        stretch = wanted
    return lattice, allocate_paths(importance, effort.paths)


def _finest_stretch(grid: DensityGrid) -> float:
    return max(THICK_SPACING, (grid.density.numel() / LARGEST_LATTICE) ** (1.0 / 3.0))


def _assemble(
    camera: Camera,
    pixel: Tensor,
    optical_length: Tensor,
    view: _View,
    asymmetry: Tensor,
    extinction: Tensor,
    orders: int,
    parts: list[_GroupImages],
) -> ScatteringTables:
    shape = (orders - 1, len(asymmetry), len(extinction), len(pixel))
    cos_sun = view.direction @ view.sun
    if parts:
        single = torch.cat([part.single for part in parts])
        multiple = torch.cat([part.halves.mean(0) for part in parts], dim=2)
        deviation = torch.cat([0.5 * (part.halves[0] - part.halves[1]) for part in parts], dim=2)
        share = torch.cat([part.effective_share for part in parts], dim=2)
    else:
        single, multiple, deviation = torch.zeros(shape[2:]), torch.zeros(shape), torch.zeros(shape)
        share = torch.ones(shape[:3])
    total = evaluate_phase_function(cos_sun, asymmetry[:, None])[:, None] * single + multiple.sum(0)
    return ScatteringTables(
        width=camera.width,
        height=camera.height,
        pixel=pixel,
        optical_length=optical_length[pixel],
        cos_sun=cos_sun,
        asymmetry=asymmetry,
        extinction=extinction,
        single=single,
        multiple=multiple,
        standard_error=_relative_rms(deviation, multiple),
        image_error=_relative_rms(deviation.sum(0), total),
        effective_share=share,
    )


def _relative_rms(deviation: Tensor, image: Tensor) -> Tensor:
    """Root of the summed squares of the deviation over that of the image, along the pixels; zero for a black image."""
    power = image.double().square().sum(-1)
    error = (deviation.double().square().sum(-1) / power.clamp(min=1e-300)).sqrt()
    return torch.where(power > 0, error, 0.0).to(torch.float32)
