"""Is a stack as accurate as its tolerance asks for, and does it know how accurate it is?

Stacks are built for random views of what a fit may search: asymmetry 0..0.9, largest optical depth 0.05..60, albedo 0.8..1. At random
parameter sets between the nodes of the table, images composed from the stack are compared with the reference path tracer on some of the
pixels, in which each is traced for long. The reference's own noise is subtracted in quadrature:

    error^2 = [ mean (stack - reference)^2 - mean variance of the reference ] / mean reference^2

What the stack states is compared with the errors that are known within a fifth; the smallest drown in the reference's noise.
"""

import argparse
import math
from dataclasses import asdict, dataclass

import torch

from benchmarks.common import (
    SHARED_VOLUME,
    Outcome,
    add_output_argument,
    available_cores,
    make_table,
    peak_memory_mb,
    set_threads,
    spread,
    stopwatch,
    tell_progress,
)
from benchmarks.parameter_sets import (
    KNOWN_WITHIN,
    LONGER,
    REFERENCE_ORDERS,
    SETS_SEED,
    THIN_DEPTH,
    ParameterSet,
    TracedPixels,
    draw_sets,
    largest_optical_length,
    table_nodes,
)
from cloudfit.quality import QUALITIES
from cloudfit.scene_record import load_volume
from precompute.scattering_orders import build_scattering_stack
from render.camera import Camera, direction_from_angles, frame_volume
from render.density_grid import DensityGrid
from render.depth_nodes import depth_coordinate
from render.interpolation import cubic_weights
from render.procedural_cloud import build_cumulus
from render.scattering_stack import ScatteringStack, bright_share
from render.units import radians_from_degrees

SUNS = {"side": (90.0, 25.0), "back": (10.0, 25.0)}
"""Azimuth and elevation [degrees]; the camera looks north."""

MET, SETS = 11, 12
"""So many of so many random sets shall meet the tolerance."""

STATED, STATED_SHARE = (0.67, 1.5), 0.9
"""Stated over true error, and the share of the known errors that shall lie between."""


@dataclass(frozen=True)
class Case:
    """One volume under one sun."""

    volume: str
    sun: str


@dataclass(frozen=True)
class Comparison:
    """One parameter set.

    Args:
        asymmetry, optical_depth, albedo: of the set.
        error: relative RMS over the pixels, the reference's noise subtracted in quadrature.
        estimated: by the stack, interpolated between its nodes.
        bias: of the mean over the pixels, relative.
        reference_noise: relative RMS.
        known: whether the error is known well enough to be compared with.
    """

    asymmetry: float
    optical_depth: float
    albedo: float
    error: float
    estimated: float
    bias: float
    reference_noise: float
    known: bool

    @property
    def stated_well(self) -> bool:
        """Whether the stated error is about the true one."""
        return STATED[0] <= self.estimated / max(self.error, 1e-6) <= STATED[1]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    parser.add_argument("--quality", nargs="+", choices=QUALITIES, default=["draft", "standard"])
    parser.add_argument("--volumes", nargs="+", choices=VOLUMES, default=list(VOLUMES))
    parser.add_argument("--suns", nargs="+", choices=SUNS, default=list(SUNS))
    parser.add_argument(
        "--at",
        choices=("random", "nodes"),
        default="random",
        help="compare at the random sets or at the nodes next to them",
    )
    parser.add_argument("--sets", type=int, default=SETS, help="random parameter sets of each case")
    parser.add_argument("--sets-seed", type=int, default=SETS_SEED, help="that they are drawn with")
    parser.add_argument("--pixels", type=int, default=400, help="that the reference traces")
    parser.add_argument("--paths", type=int, default=1_000_000, help="of one round of each reference")
    parser.add_argument(
        "--noise",
        type=float,
        default=0.006,
        help="of the reference, at which no further round is traced",
    )
    parser.add_argument(
        "--rounds", type=int, default=60, help="at most, and four times as many in thin clouds, which scatter few paths"
    )
    parser.add_argument("--threads", type=int, default=available_cores())
    add_output_argument(parser, "folder of the reference images, which are kept and found again")


def _wdas() -> DensityGrid:
    return load_volume(SHARED_VOLUME)


VOLUMES = {"wdas": _wdas, "cumulus_128": lambda: build_cumulus(128), "cumulus_200": lambda: build_cumulus(200)}


def run(arguments: argparse.Namespace) -> Outcome:
    """Compare."""
    if arguments.quick:
        arguments.volumes, arguments.suns, arguments.quality = ["quick"], ["side"], ["draft"]
        arguments.sets, arguments.pixels, arguments.paths, arguments.rounds = 2, 20, 2000, 1
    set_threads(arguments.threads)
    rows, values = [], []
    for case in (Case(volume, sun) for volume in arguments.volumes for sun in arguments.suns):
        scene = _Scene(case, arguments)
        for name in arguments.quality:
            found = scene.compare(name)
            values.append(found)
            rows.append(_row(case, name, found))
            tell_progress(" ".join(str(cell) for cell in rows[-1]))
    columns = (
        "volume",
        "sun",
        "quality",
        "seconds",
        "MB",
        f"errors [{', '.join(QUANTILES)}]",
        "within tolerance",
        f"stated / error in {STATED[0]} to {STATED[1]}",
    )
    notes = (
        f"reference: up to {arguments.rounds} times {arguments.paths} paths over {arguments.pixels} pixels to order {REFERENCE_ORDERS}, "
        f"until its noise is {arguments.noise:.1%}"
        f", in up to {LONGER} times as many below an optical depth of {THIN_DEPTH}",
        f"compared at {arguments.at} {'sets' if arguments.at == 'random' else 'next to the random sets'}",
        f"errors are relative RMS errors over pixels; known ones have a deviation of at most {KNOWN_WITHIN:.0%}",
    )
    return Outcome({"cases": values}, (make_table("Error of stacks", columns, rows),), notes)


QUANTILES = ("median", "largest")


class _Scene:
    """A volume, its views, and the references of its parameter sets."""

    def __init__(self, case: Case, arguments: argparse.Namespace) -> None:
        self.case, self.arguments = case, arguments
        self.grid = build_cumulus(24) if case.volume == "quick" else VOLUMES[case.volume]()
        width, height = (16, 12) if arguments.quick else (320, 240)
        self.camera: Camera = frame_volume(self.grid, width=width, height=height)
        azimuth, elevation = (radians_from_degrees(angle) for angle in SUNS[case.sun])
        self.sun = torch.tensor(direction_from_angles(azimuth, elevation))
        self.largest = largest_optical_length(self.grid, self.camera)
        self.traced = TracedPixels(
            self.grid,
            self.camera,
            self.sun,
            arguments.pixels,
            arguments.paths,
            arguments.out,
            arguments.noise,
            arguments.rounds,
        )

    def compare(self, quality: str) -> dict[str, object]:
        """Build a stack and compare it."""
        chosen = QUALITIES[quality]
        asymmetry, extinction = table_nodes(chosen, self.largest)
        with stopwatch() as seconds:
            tables = build_scattering_stack(
                self.grid, self.camera, self.sun, asymmetry, extinction, chosen.table_effort, 1
            )
        stack = ScatteringStack(tables)
        tolerance = chosen.table_effort.tolerance or math.inf
        sets = draw_sets(self.arguments.sets, self.arguments.sets_seed)
        if self.arguments.at == "nodes":
            sets = [one.at_node(asymmetry, extinction * self.largest) for one in sets]
        comparisons = [self._compare_set(stack, one, number) for number, one in enumerate(sets)]
        return {
            "case": asdict(self.case),
            "quality": quality,
            "tolerance": tolerance,
            "seconds": seconds[0],
            "peak_mb": peak_memory_mb(),
            "groups": tables.groups,
            "known": sum(one.known for one in comparisons),
            "stated_well": sum(one.known and one.stated_well for one in comparisons),
            "sets": [asdict(one) for one in comparisons],
        }

    def _compare_set(self, stack: ScatteringStack, one: ParameterSet, number: int) -> Comparison:
        found = self.traced.compare(stack, one, number)
        return Comparison(
            one.asymmetry,
            one.optical_depth,
            one.albedo,
            found.error,
            estimated_error(stack, one, one.optical_depth / self.largest),
            found.bias,
            found.noise,
            found.known,
        )


def estimated_error(stack: ScatteringStack, one: ParameterSet, extinction: float) -> float:
    """Error that the stack states, interpolated between nodes as its images are, and over albedos as `ScatteringStack` does."""
    tables = stack.tables
    soft = tables.soft_extinction
    rows = cubic_weights(tables.asymmetry, torch.tensor([one.asymmetry]))[0]
    columns = cubic_weights(
        depth_coordinate(tables.extinction, soft), depth_coordinate(torch.tensor([extinction]), soft)
    )[0]
    stated = torch.lerp(tables.image_error, tables.bright_error, bright_share(torch.tensor(one.albedo)))
    return float((rows @ stated @ columns).clamp(min=0.0))


def _row(case: Case, quality: str, found: dict[str, object]) -> tuple[object, ...]:
    sets: list[dict[str, float]] = found["sets"]  # type: ignore[assignment]
    errors = [one["error"] for one in sets]
    tolerance = float(found["tolerance"])  # type: ignore[arg-type]
    met = sum(error <= tolerance for error in errors)
    summary = spread(errors)
    return (
        case.volume,
        case.sun,
        f"{quality} ({tolerance:.1%})",
        found["seconds"],
        found["peak_mb"],
        f"{summary['median']:.2%}, {summary['largest']:.2%}",
        f"{met} of {len(sets)} (accepted {MET} of {SETS})",
        _show_stated(found),
    )


def _show_stated(found: dict[str, object]) -> str:
    """How many stated errors are about the true ones, of those that are known, and the extremes of their ratios."""
    if not found["known"]:
        return "none known"
    sets: list[dict[str, float]] = found["sets"]  # type: ignore[assignment]
    ratios = spread(one["estimated"] / one["error"] for one in sets if one["known"])
    return (
        f"{found['stated_well']} of {found['known']} known (accepted {STATED_SHARE:.0%}): "
        f"{ratios['median']:.2f} [{ratios['smallest']:.2f}, {ratios['largest']:.2f}]"
    )
