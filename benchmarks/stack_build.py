"""One stack of the procedural cumulus, built in a process that does nothing else: seconds, memory and error, by part."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from types import MappingProxyType

import torch

from benchmarks.common import peak_memory_mb, scene_with, set_threads, stopwatch
from benchmarks.parameter_sets import (
    Disagreement,
    ParameterSet,
    TracedPixels,
    largest_optical_length,
    table_nodes,
    varied,
)
from cloudfit.quality import Quality
from cloudfit.scene import Scene
from precompute.error_budget import Effort
from precompute.scattering_orders import build_scattering_stack
from render.fused import torch_loops_only
from render.procedural_cloud import build_cumulus
from render.scattering_stack import ScatteringStack, ScatteringTables
from render.trilinear import TrilinearTable

WARM_UP_SIZE = (32, 24)

WARM_UP_EFFORT = Effort(4, 200, 2_000, 2)


@contextmanager
def _compiled() -> Iterator[None]:
    """The torch loops, the trilinear look-up compiled: it takes most of their time, and has no shapes that depend on data.

    Compiling the march itself was slower than not doing so: the number of rays under way changes with each step, and with it the code.
    """
    look_up = torch.compile(TrilinearTable._look_up_chunk, dynamic=True)
    with torch_loops_only(), varied(((TrilinearTable, "_look_up_chunk", look_up),)):
        yield


LOOPS: Mapping[str, Callable[[], AbstractContextManager[None]]] = MappingProxyType(
    {"fused": nullcontext, "torch": torch_loops_only, "compiled": _compiled}
)
"""Ways to trace the same paths."""


@dataclass(frozen=True)
class BuildTask:
    """What a process is told.

    Args:
        side: voxels along the longest side of the cumulus.
        width, height: of the tables.
        quality: effort and numbers of nodes.
        seed: of the random streams.
        threads: of the process.
        loops: name in `LOOPS`.
    """

    side: int
    width: int
    height: int
    quality: Quality
    seed: int
    threads: int
    loops: str = "fused"


@dataclass(frozen=True)
class BuildCost:
    """What a stack took and reached.

    Args:
        seconds: to build.
        warm_up_seconds: that a stack of few paths and pixels took before: compilation, or loading what had been compiled.
        before_mb, peak_mb: largest resident memory before the build, with the volume loaded, and at its end.
        table_mb: of the tables in memory.
        cloud_pixels: that the tables hold.
        paths: traced.
        error: that eleven of twelve nodes and albedos do not exceed, in the worst group, as the stack states.
        error_median: of the nodes, as the stack states.
        parts: seconds by part, all groups together.
    """

    seconds: float
    warm_up_seconds: float
    before_mb: float
    peak_mb: float
    table_mb: float
    cloud_pixels: int
    paths: int
    error: float
    error_median: float
    parts: dict[str, float]


def build(task: BuildTask) -> BuildCost:
    """Build a stack; for a process of its own."""
    return _build(task)[0]


@dataclass(frozen=True)
class PeerTask:
    """A stack to be compared with the path tracer.

    Args:
        build: of the stack.
        nodes: parameter sets at which to compare.
        pixels, paths: of the path tracer.
    """

    build: BuildTask
    nodes: tuple[ParameterSet, ...]
    pixels: int
    paths: int


def build_and_compare(task: PeerTask) -> tuple[BuildCost, list[Disagreement]]:
    """Build a stack, and compare it with the path tracer at some nodes; for a process of its own."""
    cost, tables = _build(task.build)
    scene = scene_with(build_cumulus(task.build.side), None, task.build.width, task.build.height)
    traced = TracedPixels(scene.grid, scene.camera, scene.sun_direction, task.pixels, task.paths, None)
    stack = ScatteringStack(tables)
    return cost, [traced.compare(stack, one, number) for number, one in enumerate(task.nodes)]


def _build(task: BuildTask) -> tuple[BuildCost, ScatteringTables]:
    set_threads(task.threads)
    scene = scene_with(build_cumulus(task.side), None, task.width, task.height)
    small = replace(scene, camera=scene.camera.resized(*WARM_UP_SIZE))
    with LOOPS[task.loops](), torch.no_grad():
        with stopwatch() as warm_up:
            _build_tables(small, task, WARM_UP_EFFORT)
        before = peak_memory_mb()
        with stopwatch() as seconds:
            tables = _build_tables(scene, task, task.quality.table_effort)
    parts: dict[str, float] = {}
    for group in tables.groups:
        for part, spent in dict(group["seconds"]).items():  # type: ignore[call-overload]
            parts[part] = parts.get(part, 0.0) + spent
    cost = BuildCost(
        seconds[0],
        warm_up[0],
        before,
        peak_memory_mb(),
        (tables.multiple.nbytes + tables.single.nbytes) / (1 << 20),
        len(tables.pixel),
        sum(int(str(group["paths"])) for group in tables.groups),
        max(float(str(group["error"])) for group in tables.groups),
        float(tables.image_error.median()),
        parts,
    )
    return cost, tables


def _build_tables(scene: Scene, task: BuildTask, effort: Effort) -> ScatteringTables:
    nodes = table_nodes(task.quality, largest_optical_length(scene.grid, scene.camera))
    return build_scattering_stack(scene.grid, scene.camera, scene.sun_direction, *nodes, effort, task.seed)
