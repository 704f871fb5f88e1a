"""Does the reference path tracer confirm what the stack promised for the best candidates of real photographs?

Each photograph is fitted on a stack; the winner is rendered again by the reference path tracer at the resolution of the stack, with every
order of scattering, and scored with the same sky, air and histogram. Whatever the search has exploited in the noise or bias of the stack
comes out as a difference of the two losses.
"""

import argparse
import tempfile
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.common import (
    QUICK_QUALITY,
    SHARED,
    Outcome,
    add_volume_argument,
    available_cores,
    make_table,
    scene_of,
    set_threads,
    show,
    spread,
    stopwatch,
    tell_progress,
)
from benchmarks.synthetic_photograph import MIDDLE, photograph_of_opacity
from cloudfit.air_search import search_haze
from cloudfit.analysis import PhotographAnalysis, analyse_photograph
from cloudfit.colour_histogram import colour_histogram
from cloudfit.fit_problem import FitProblem
from cloudfit.fit_types import FitOptions
from cloudfit.losses import LOSSES
from cloudfit.photograph import read_photograph
from cloudfit.quality import QUALITIES
from cloudfit.scene import Scene
from cloudfit.search import search_parameters
from cloudfit.stack import prepare_stack
from render.cloud_image import blend_air, compose_cloud
from render.image_files import write_png
from render.path_tracer import trace_reference
from render.scattering_stack import CloudLayers

PHOTOGRAPHS = ("altocumulus", "cumulus_kloofendal", "cumulus_meadow", "cumulus_noon", "cumulus_picos", "dusk")
"""Beginnings of the names of the photographs that are fitted; the first of each."""

REFERENCE_ORDERS = 100_000
"""In a cloud of albedo one light is scattered until it comes out; the last of it, in a deep one, after tens of thousands of times."""

ACCEPTED = 0.03


@dataclass(frozen=True)
class PromiseRecord:
    """One photograph.

    Args:
        name: of the file.
        promised: loss of the winner on the stack.
        reference: loss of the same parameters and air in the reference path tracer.
        noise: relative RMS of the reference's cloud pixels, which widens its histogram.
        image_error: relative RMS difference of both grey images, the reference's noise subtracted in quadrature.
        parameters: of the winner.
        air_depth: red, green, blue.
        seconds: of the reference.
    """

    name: str
    promised: float
    reference: float
    noise: float
    image_error: float
    parameters: dict[str, float]
    air_depth: list[float]
    seconds: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    add_volume_argument(parser)
    parser.add_argument("--photographs", type=Path, default=SHARED / "photos", help="folder")
    parser.add_argument("--names", nargs="+", default=list(PHOTOGRAPHS), help="beginnings of the files' names")
    parser.add_argument("--quality", choices=QUALITIES, default="standard")
    parser.add_argument("--width", type=int, default=320, help="of stack and reference; 4:3")
    parser.add_argument("--samples", type=int, default=128, help="paths of one round of the reference per pixel")
    parser.add_argument(
        "--noise", type=float, default=0.02, help="of the reference, at which no further round is traced"
    )
    parser.add_argument("--rounds", type=int, default=100, help="at most; those of thin clouds are soon done")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=available_cores())
    parser.add_argument("--out", type=Path, help="folder of the stack and of the pictures")


def run(arguments: argparse.Namespace) -> Outcome:
    """Fit, trace, compare; a quick run fits a photograph that it renders itself."""
    if arguments.quick:
        arguments.width, arguments.samples = 32, 16
    set_threads(arguments.threads)
    with tempfile.TemporaryDirectory() if arguments.out is None else nullcontext(arguments.out) as folder:
        out = Path(folder)
        out.mkdir(parents=True, exist_ok=True)
        scene, volume = scene_of(arguments, arguments.width, arguments.width * 3 // 4)
        quality = QUICK_QUALITY if arguments.quick else replace(QUALITIES[arguments.quality], table_scale=1.0)
        stack, report = prepare_stack(scene, quality, arguments.seed, out / "tables")
        tell_progress(f"stack: {report.seconds:.0f} s")
        records = []
        for name, analysis in _photographs(arguments, scene, out):
            problem = FitProblem(analysis, stack)
            records.append(_compare(name, problem, scene, FitOptions(quality, seed=arguments.seed), arguments, out))
            tell_progress(f"{name}: promised {records[-1].promised:.3f}, reference {records[-1].reference:.3f}")
    columns = ("photograph", "promised", "reference", "difference", "image error", "reference's noise", "seconds")
    rows = [
        (
            record.name,
            f"{record.promised:.3f}",
            f"{record.reference:.3f}",
            f"{record.reference - record.promised:+.3f}",
            f"{record.image_error:.1%}",
            f"{record.noise:.1%}",
            record.seconds,
        )
        for record in records
    ]
    differences = spread(abs(record.reference - record.promised) for record in records)
    notes = (
        f"difference of the losses: median [quartiles] {show(differences)}, largest {differences['largest']:.3f}, accepted {ACCEPTED}",
    )
    values = {"volume": volume, "summary": differences, "photographs": [asdict(record) for record in records]}
    return Outcome(values, (make_table(f"Promises of the stack with {volume}", columns, rows),), notes)


def _photographs(arguments: argparse.Namespace, scene: Scene, out: Path) -> list[tuple[str, PhotographAnalysis]]:
    if arguments.quick:
        return [("cumulus", photograph_of_opacity(scene, scene.camera, MIDDLE, out / "cumulus.png").analysis())]
    files = sorted(path for path in arguments.photographs.iterdir() if path.is_file())
    chosen = [next(path for path in files if path.name.startswith(name)) for name in arguments.names]
    return [(path.name, analyse_photograph(read_photograph(path))) for path in chosen]


def _compare(
    name: str, problem: FitProblem, scene: Scene, options: FitOptions, arguments: argparse.Namespace, out: Path
) -> PromiseRecord:
    best = search_parameters(problem, replace(options, searches=1 if arguments.quick else options.searches)).final
    physical = problem.space.to_physical(best.best[None]).to(torch.float32)
    parameters = problem.space.as_dict(physical[0])
    pixels = problem.stack.pixel[problem.counted]
    with stopwatch() as seconds:
        traced, variance = _trace(scene, parameters, pixels, arguments)
    loss, seen, air, grey = _score(problem, physical, traced)
    picture = torch.zeros(scene.camera.height * scene.camera.width, 3)
    picture[pixels] = seen
    write_png(out / f"{Path(name).stem}_reference.png", picture.unflatten(0, (scene.camera.height, scene.camera.width)))
    power = traced.double().square().mean().clamp(min=1e-300)
    square = ((grey - traced).double().square().mean() - variance.mean()) / power
    return PromiseRecord(
        name,
        best.best_loss,
        loss,
        float((variance.mean() / power).sqrt()),
        float(square.clamp(min=0.0).sqrt()),
        parameters,
        air.tolist(),
        seconds[0],
    )


def _trace(
    scene: Scene, parameters: dict[str, float], pixels: Tensor, arguments: argparse.Namespace
) -> tuple[Tensor, Tensor]:
    """Light of the pixels and its variance, in rounds until the noise is small enough: thin clouds scatter few paths."""
    total, variance = (torch.zeros(len(pixels), dtype=torch.float64) for _ in range(2))
    for turn in range(1, arguments.rounds + 1):
        image = trace_reference(
            scene.grid,
            scene.camera,
            scene.sun_direction,
            extinction=parameters["extinction"],
            asymmetry=parameters["asymmetry"],
            albedo=parameters["albedo"],
            orders=REFERENCE_ORDERS,
            samples=arguments.samples,
            seed=arguments.seed + 1000 * turn,
            pixels=pixels,
            recorded=1,
        )
        total += image.radiance[pixels]
        variance += image.radiance_variance[pixels]
        noise = float((variance.mean() / total.square().mean().clamp(min=1e-300)).sqrt())
        if noise <= arguments.noise or arguments.quick:
            break
    return (total / turn).float(), variance / turn**2


@torch.no_grad()
def _score(problem: FitProblem, physical: Tensor, traced: Tensor) -> tuple[float, Tensor, Tensor, Tensor]:
    """Loss of traced light `(pixel,)` behind the air that is best on the stack.

    Returns:
        The loss, the picture `(pixel, channel)`, the air's depth `(channel,)`, and the stack's own light `(pixel,)`.
    """
    curve = problem.display_curve
    found = search_haze(problem.compose(physical), problem.sky, problem.target, curve, problem.air_refinements)
    layers = problem.stack(*(physical[:, problem.space.names.index(n)] for n in ("asymmetry", "extinction", "albedo")))
    counted = problem.counted
    # The transmittance is known in closed form: only the scattered light is in question.
    exact = CloudLayers(
        traced[None], torch.zeros_like(traced)[None], layers.transmittance[:, counted], layers.opacity[:, counted]
    )
    cloud = compose_cloud(exact, problem.lighting(physical), problem.sky)
    seen = blend_air(cloud, problem.sky, found.air_depth.to(torch.float32))[0].T.contiguous()
    loss = float(LOSSES["l1"](colour_histogram(seen, curve), problem.target).mean())
    return loss, seen, found.air_depth[0], (layers.single + layers.multiple)[0, counted]
