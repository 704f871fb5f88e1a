"""How close does a fit come to photographs whose parameters are known, and does it find these parameters?

The photographs are rendered by the reference path tracer, which shares nothing with the stack but the density look-up and the phase
function: same volume, camera, sun and largest order as the fit, everything else random. Each is fitted from several seeds. What
the loss is compared with is its floor: two images of equal appearance with unrelated pixels differ by that much.
"""

import argparse
import tempfile
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.common import (
    QUICK_QUALITY,
    Outcome,
    add_jobs_argument,
    add_volume_argument,
    harmonic_mean,
    scene_of,
    set_threads,
    tell_progress,
)
from benchmarks.recovery_report import (
    FitRecord,
    PhotographRecord,
    loss_table,
    parameter_table,
    summarise,
    summary_table,
    write_contact_sheet,
)
from benchmarks.synthetic_photograph import (
    ORDERS,
    SyntheticPhotograph,
    Truth,
    draw_truth,
    photograph_by_path_tracing,
)
from cloudfit.analysis import PhotographAnalysis
from cloudfit.colour_histogram import colour_histogram
from cloudfit.fit import fit_photograph
from cloudfit.fit_problem import FitProblem
from cloudfit.fit_types import FitOptions
from cloudfit.losses import LOSSES, flat_l1_floor, l1_floor
from cloudfit.optimisers import DEFAULT_OPTIMISER, OPTIMISERS
from cloudfit.quality import QUALITIES, Quality
from cloudfit.scene import Scene
from cloudfit.stack import prepare_stack
from render.cloud_image import blend_air
from render.image_files import write_png
from render.scattering_stack import ScatteringStack

WIDTH, HEIGHT = 320, 240
"""Size of the tables and the pictures."""

NOISE_FACTORS = (4.0, 2.0)
"""The first photograph is rendered again with so many times the noise, to see what noise does to the result."""


@dataclass(frozen=True)
class Plan:
    """What is done; a process rebuilds everything it needs from it.

    Args:
        arguments: of the command line.
        folder: of all files.
    """

    arguments: argparse.Namespace
    folder: Path

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of tables and pictures."""
        return (48, 36) if self.arguments.quick else (WIDTH, HEIGHT)

    @property
    def quality(self) -> Quality:
        """Effort of the fit, with tables as large as the pictures."""
        if self.arguments.quick:
            return QUICK_QUALITY
        quality = QUALITIES[self.arguments.quality]
        table, picture = (
            replace(effort, orders=ORDERS, tail=False) for effort in (quality.table_effort, quality.picture_effort)
        )
        return replace(quality, table_scale=1.0, table_effort=table, picture_effort=picture)

    def scene(self) -> tuple[Scene, str]:
        """Scene of fits, and the name of its volume."""
        return scene_of(self.arguments, *self.size)


@dataclass(frozen=True)
class Rendering:
    """One photograph to be rendered: its name, its number in the random sequence, and the noise to aim at."""

    name: str
    number: int
    noise: float


@dataclass(frozen=True)
class FitTask:
    """One fit: which photograph, and the seed of the search."""

    rendering: Rendering
    seed: int


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    add_volume_argument(parser)
    add_jobs_argument(parser)
    parser.add_argument("--photographs", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=10, help="fits of each photograph")
    parser.add_argument("--analysis", choices=ANALYSES, default="given", help="mask, sky and sunlight")
    parser.add_argument("--optimiser", choices=OPTIMISERS, default=DEFAULT_OPTIMISER)
    parser.add_argument("--quality", choices=QUALITIES, default="standard")
    parser.add_argument("--noise", type=float, default=0.02, help="of a photograph's pixels, relative")
    parser.add_argument("--most-samples", type=int, default=8192, help="paths per pixel that are never exceeded")
    parser.add_argument("--photograph-width", type=int, default=WIDTH, help="fewer are traced sooner; 4:3")
    parser.add_argument("--out", type=Path, help="folder for the photographs, the stack, the pictures and contact.png")


def _given(photograph: SyntheticPhotograph) -> PhotographAnalysis:
    return photograph.analysis()


def _automatic(photograph: SyntheticPhotograph) -> PhotographAnalysis:
    return photograph.automatic_analysis()


ANALYSES = {"given": _given, "automatic": _automatic}


def run(arguments: argparse.Namespace) -> Outcome:
    """Render, fit, report."""
    if arguments.quick:
        arguments.photographs, arguments.seeds, arguments.jobs = 2, 2, 1
        arguments.photograph_width, arguments.noise = 48, 0.1
    with tempfile.TemporaryDirectory() if arguments.out is None else nullcontext(arguments.out) as folder:
        plan = Plan(arguments, Path(folder))
        (plan.folder / "pictures").mkdir(parents=True, exist_ok=True)
        return _run(plan)


def _run(plan: Plan) -> Outcome:
    arguments = plan.arguments
    renderings = [Rendering(f"{n:02d}", n, arguments.noise) for n in range(arguments.photographs)]
    noisier = [Rendering(f"00-noise-x{factor:g}", 0, factor * arguments.noise) for factor in NOISE_FACTORS]
    scene, volume = plan.scene()
    stack, report = prepare_stack(scene, plan.quality, 0, plan.folder / "tables")
    tell_progress(f"stack of {volume}: {report.seconds:.0f} s{', from a file' if report.reused else ''}")
    tasks = [FitTask(rendering, seed) for rendering in (*renderings, *noisier) for seed in range(arguments.seeds)]
    photographs, fits = _work(plan, [*renderings, *noisier], tasks)
    regular = photographs[: len(renderings)]
    regular_fits = fits[: len(renderings) * arguments.seeds]
    sheet = write_contact_sheet(plan.folder, regular, regular_fits)
    if arguments.out is not None:
        tell_progress(f"photographs beside their fits: {sheet}")
    summary = summarise(regular_fits, regular)
    names = ("analysis", "optimiser", "quality", "noise", "most_samples", "photograph_width", "seeds")
    values = {
        "volume": volume,
        "size": plan.size,
        "orders": ORDERS,
        "nodes": list(stack.usable.shape),
        "usable_nodes": float(stack.usable.float().mean()),
        "settings": {name: getattr(arguments, name) for name in names},
        "summary": summary,
        "photographs": [asdict(record) for record in photographs],
        "fits": [asdict(record) for record in fits],
    }
    tables = (loss_table(photographs, fits), parameter_table(photographs, fits), summary_table(summary))
    return Outcome(values, tables, NOTES)


NOTES = (
    f"photographs and fit stop at {ORDERS} scatterings; the sky is a smooth gradient; ambient light has the sunlight's colour",
    "loss: of the best candidate's own picture; searched: what the stack promised; truth: of the true parameters on the stack; "
    "true air: the same with the true air, without the steps in which the search tries it",
    "floor: expected loss of two unrelated samples of the photograph's histogram with as many pixels as photograph and picture; "
    "flat: the same of a flat histogram, 18 / sqrt(pixels)",
    "noise: relative standard deviation of a cloud pixel of the photograph, median and RMS; it widens the histogram, see the rows of "
    "photograph 00",
)


def _work(
    plan: Plan, renderings: list[Rendering], tasks: list[FitTask]
) -> tuple[list[PhotographRecord], list[FitRecord]]:
    """Render all photographs, then fit all of them, in processes of one thread if more than one is asked for."""
    if plan.arguments.jobs == 1:
        _start(plan)
        return [_render(one) for one in renderings], [_fit(one) for one in tasks]
    with ProcessPoolExecutor(plan.arguments.jobs, get_context("spawn"), _start, (plan,)) as pool:
        photographs = list(pool.map(_render, renderings))
        return photographs, list(pool.map(_fit, tasks))


@dataclass(frozen=True, eq=False)
class _Bench:
    """What a process works with."""

    plan: Plan
    scene: Scene
    stack: ScatteringStack


_bench: list[_Bench] = []


def _start(plan: Plan) -> None:
    """First thing in a process."""
    if plan.arguments.jobs > 1:
        set_threads(1)
    scene, _ = plan.scene()
    stack, _ = prepare_stack(scene, plan.quality, 0, plan.folder / "tables")
    _bench[:] = [_Bench(plan, scene, stack)]


def _photograph(rendering: Rendering) -> SyntheticPhotograph:
    """The photograph, rendered now or found in the folder."""
    bench = _bench[0]
    arguments = bench.plan.arguments
    width = arguments.photograph_width
    return photograph_by_path_tracing(
        bench.scene,
        bench.scene.camera.resized(width, width * 3 // 4),
        _truth(rendering.number),
        bench.plan.folder / f"photograph-{rendering.name}.png",
        noise=rendering.noise,
        most_samples=arguments.most_samples,
        seed=rendering.number,
    )


def _truth(number: int) -> Truth:
    return draw_truth(torch.Generator().manual_seed(1_000 + number))


def _physical(truth: Truth, stack: ScatteringStack) -> Tensor:
    """True parameters `(1, parameter)` in the order of the search space."""
    extinction = truth.optical_depth / stack.tables.largest_optical_length
    return torch.tensor([[truth.sunlight_intensity, truth.asymmetry, extinction, truth.albedo, truth.ambient]])


def _render(rendering: Rendering) -> PhotographRecord:
    bench = _bench[0]
    photograph = _photograph(rendering)
    problem = FitProblem(photograph.analysis(), bench.stack)
    unit = problem.space.to_unit(_physical(photograph.truth, bench.stack))
    tell_progress(
        f"photograph {rendering.name}: {photograph.samples} paths a pixel, noise {photograph.noise:.1%} ({photograph.noise_rms:.1%} RMS)"
    )
    return PhotographRecord(
        rendering.name,
        photograph.truth,
        problem.space.as_dict(unit[0]),
        photograph.noise,
        photograph.noise_rms,
        photograph.samples,
        int(photograph.cloud.sum()),
        float(problem.evaluate(unit.clamp(0.0, 1.0))[0]),
        _loss_with_true_air(problem, photograph.truth, bench.stack),
    )


def _loss_with_true_air(problem: FitProblem, truth: Truth, stack: ScatteringStack) -> float:
    """Loss of the truth on the stack without the steps of the search over the air."""
    cloud = problem.compose(_physical(truth, stack))
    image = blend_air(cloud, problem.sky, torch.tensor([truth.air_depth]))[0]
    histogram = colour_histogram(image.T.contiguous(), problem.display_curve)
    return float(LOSSES["l1"](histogram, problem.target).mean())


def _fit(task: FitTask) -> FitRecord:
    bench = _bench[0]
    arguments = bench.plan.arguments
    analysis = ANALYSES[arguments.analysis](_photograph(task.rendering))
    options = FitOptions(quality=bench.plan.quality, optimiser=arguments.optimiser, candidates=1, seed=task.seed)
    fit = fit_photograph(analysis, bench.scene, bench.stack, options)
    best = fit.candidates[0]
    problem = FitProblem(analysis, bench.stack)
    cloud = int(analysis.mask.cloud.sum())
    counted = len(problem.counted)  # of the stack and of the picture, which are of one size
    shared = harmonic_mean(cloud, counted)
    unit = problem.space.to_unit(torch.tensor([list(best.parameters.values())]))[0]
    picture = bench.plan.folder / "pictures" / f"{task.rendering.name}-seed-{task.seed}.png"
    write_png(picture, best.picture.rgb)
    tell_progress(f"photograph {task.rendering.name}, seed {task.seed}: {best.promised_loss:.3f} -> {best.loss:.3f}")
    return FitRecord(
        photograph=task.rendering.name,
        seed=task.seed,
        searched_loss=best.promised_loss,
        loss=best.loss,
        floor=float(l1_floor(problem.target, shared).mean()),
        flat_floor=flat_l1_floor(shared),
        wasserstein=best.wasserstein,
        unit=problem.space.as_dict(unit),
        parameters=best.parameters,
        optical_depth=best.parameters["extinction"] * bench.stack.tables.largest_optical_length,
        air_depth=best.air_depth,
        seconds=fit.seconds,
        evaluations=fit.evaluations,
        picture=str(picture.relative_to(bench.plan.folder)),
    )
