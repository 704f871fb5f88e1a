"""What do fits of a folder of photographs reach, in what time and memory?

Each photograph is fitted by `cloudfit.batch` in a process of its own, so that its peak memory is its own; the stack is built once, before.
"""

import argparse
import tempfile
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

from benchmarks.common import (
    QUICK_QUALITY,
    SHARED,
    Outcome,
    add_volume_argument,
    available_cores,
    make_table,
    peak_memory_mb,
    scene_of,
    set_threads,
    show,
    spread,
    stopwatch,
    tell_progress,
)
from benchmarks.synthetic_photograph import MIDDLE, photograph_of_opacity
from cloudfit.batch import BatchSettings, fit_folder
from cloudfit.fit_types import FitOptions
from cloudfit.optimisers import DEFAULT_OPTIMISER, OPTIMISERS
from cloudfit.photograph import list_photographs
from cloudfit.quality import QUALITIES
from cloudfit.stack import prepare_stack


@dataclass(frozen=True)
class Task:
    """One photograph, as its process is told."""

    arguments: argparse.Namespace
    photograph: Path
    out: Path


@dataclass(frozen=True)
class FitRecord:
    """What became of a photograph; no losses without a fit.

    Args:
        name: of the file.
        status: "done", "no_cloud" or "failed".
        reason: sentence, or None for a fit.
        loss, floor, wasserstein: of the best picture.
        seconds: from the photograph to its folder of results, with the stack at hand.
        peak_memory_mb: of the process.
    """

    name: str
    status: str
    reason: str | None
    loss: float | None
    floor: float | None
    wasserstein: float | None
    seconds: float
    peak_memory_mb: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    add_volume_argument(parser)
    parser.add_argument("--photographs", type=Path, default=SHARED / "photos", help="folder")
    parser.add_argument("--quality", choices=QUALITIES, default="standard")
    parser.add_argument("--optimiser", choices=OPTIMISERS, default=DEFAULT_OPTIMISER)
    parser.add_argument("--width", type=int, default=640, help="of the pictures; 4:3")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=available_cores())
    parser.add_argument("--out", type=Path, help="folder of the results")


def run(arguments: argparse.Namespace) -> Outcome:
    """Fit each photograph; a quick run fits one that it renders itself."""
    if arguments.quick:
        arguments.width = 48
    set_threads(arguments.threads)
    with tempfile.TemporaryDirectory() if arguments.out is None else nullcontext(arguments.out) as folder:
        out = Path(folder)
        out.mkdir(parents=True, exist_ok=True)
        scene, volume = scene_of(arguments, arguments.width, arguments.width * 3 // 4)
        photographs = [_render(arguments, out)] if arguments.quick else list_photographs(arguments.photographs)
        _, stack = prepare_stack(scene, _options(arguments).quality, arguments.seed, out / "tables")
        records = []
        for photograph in photographs:
            with ProcessPoolExecutor(1, get_context("spawn")) as pool:
                records.append(pool.submit(_fit, Task(arguments, photograph, out)).result())
            tell_progress(f"{records[-1].name}: {records[-1].status}, {records[-1].seconds:.0f} s")
    return _report(arguments, volume, stack.seconds, records)


def _report(arguments: argparse.Namespace, volume: str, stack_seconds: float, records: list[FitRecord]) -> Outcome:
    columns = ("photograph", "status", "loss", "floor", "loss / floor", "grey levels", "seconds", "peak memory, MB")
    rows = []
    for r in records:
        ratio = None if r.loss is None or r.floor is None else r.loss / r.floor
        losses = ["" if value is None else f"{value:.3f}" for value in (r.loss, r.floor, ratio, r.wasserstein)]
        rows.append([r.name, r.status, *losses, r.seconds, r.peak_memory_mb])
    fitted = [r for r in records if r.loss is not None and r.floor is not None]
    summary = {"stack_seconds": stack_seconds, "fitted": len(fitted), "photographs": len(records)}
    measures = {
        "loss": [r.loss for r in fitted if r.loss is not None],
        "wasserstein": [r.wasserstein for r in fitted if r.wasserstein is not None],
        "seconds": [r.seconds for r in fitted],
        "peak_memory_mb": [r.peak_memory_mb for r in fitted],
    }
    spreads = {name: spread(values) for name, values in measures.items() if values}
    notes = [f"stack, once for all photographs: {stack_seconds:.1f} s", "grey levels: Wasserstein distance"]
    notes += [f"{name}: median [quartiles] {show(values)}" for name, values in spreads.items()]
    notes += [f"{r.name}: {r.reason}" for r in records if r.reason is not None]
    values = {
        "volume": volume,
        "settings": {n: getattr(arguments, n) for n in ("quality", "optimiser", "width", "seed", "threads")},
        "summary": {**summary, **spreads},
        "photographs": [asdict(record) for record in records],
    }
    return Outcome(values, (make_table(f"Fits with {volume}", columns, rows),), tuple(notes))


def _fit(task: Task) -> FitRecord:
    """Fit one photograph; runs in a process of its own."""
    arguments = task.arguments
    set_threads(arguments.threads)
    scene, _ = scene_of(arguments, arguments.width, arguments.width * 3 // 4)
    settings = BatchSettings(task.out / "results" / task.photograph.stem, tables=task.out / "tables", force=True)
    with stopwatch() as seconds:
        outcome = fit_folder([task.photograph], scene, _options(arguments), settings).outcomes[0]
    return FitRecord(
        task.photograph.name,
        outcome.status,
        outcome.reason,
        outcome.loss,
        outcome.floor,
        outcome.wasserstein,
        seconds[0],
        peak_memory_mb(),
    )


def _options(arguments: argparse.Namespace) -> FitOptions:
    quality = QUICK_QUALITY if arguments.quick else QUALITIES[arguments.quality]
    candidates = 1 if arguments.quick else FitOptions().candidates
    return FitOptions(quality, optimiser=arguments.optimiser, candidates=candidates, seed=arguments.seed)


def _render(arguments: argparse.Namespace, folder: Path) -> Path:
    scene, _ = scene_of(arguments, arguments.width, arguments.width * 3 // 4)
    path = folder / "cumulus.png"
    photograph_of_opacity(scene, scene.camera, MIDDLE, path)
    return path
