"""What every benchmark shares: the scene, the machine's description, medians and quartiles, and the report."""

import argparse
import importlib.metadata
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import torch
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from cloudfit import __version__
from cloudfit.quality import Quality
from cloudfit.scene import Scene
from cloudfit.scene_record import load_volume
from precompute.error_budget import Effort
from render.atomic_write import atomic_path
from render.camera import frame_volume
from render.density_grid import DensityGrid
from render.procedural_cloud import build_cumulus
from render.units import radians_from_degrees

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"
SHARED_VOLUME = SHARED / "volumes" / "wdas_cloud_sixteenth.npz"

QUICK_RESOLUTION = 40
"""Voxels along the longest side of the cumulus that quick runs use."""

QUICK_QUALITY = Quality(1.0, Effort(4, 4_000, 40_000, 4), Effort(4, 4_000, 40_000, 4), 4, 0.7, 10.0)
"""Tables and pictures of quick runs: coarse, and accepted whatever their error."""

SUN_AZIMUTH_DEG, SUN_ELEVATION_DEG = 220.0, 40.0

PACKAGES = ("torch", "numpy", "scipy", "kornia", "opencv-contrib-python-headless", "nlopt", "cma")


@dataclass(frozen=True)
class Outcome:
    """Answer of a benchmark.

    Args:
        values: everything measured, as JSON.
        tables: the same to read.
        notes: sentences about what was measured how, and what falls short.
    """

    values: Mapping[str, object]
    tables: tuple[Table, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Benchmark:
    """One question.

    Args:
        question: first line of the module's documentation.
        add_arguments: adds the options of its own to a parser that has --quick and --json.
        run: answers it.
    """

    question: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], Outcome]


def first_line(text: str | None) -> str:
    """First line of a documentation string."""
    return (text or "").strip().splitlines()[0]


def spread(values: Iterable[float]) -> dict[str, float]:
    """Median and quartiles of measurements, their number, and the extremes."""
    ordered = sorted(float(value) for value in values)
    if not ordered:
        raise ValueError("there is no median of no measurements")
    low, median, high = statistics.quantiles(ordered, n=4, method="inclusive") if len(ordered) > 1 else ordered * 3
    return {
        "median": median,
        "lower_quartile": low,
        "upper_quartile": high,
        "smallest": ordered[0],
        "largest": ordered[-1],
        "count": len(ordered),
    }


def harmonic_mean(first: int, second: int) -> int:
    """Number of pixels n of two images of one size that differ by chance as images of these two sizes do: 2/n = 1/a + 1/b."""
    return max(1, round(2.0 / (1.0 / first + 1.0 / second)))


def show(summary: dict[str, float], digits: int = 3) -> str:
    """Median and quartiles on one line."""
    low, median, high = (summary[name] for name in ("lower_quartile", "median", "upper_quartile"))
    return f"{median:.{digits}g} [{low:.{digits}g}, {high:.{digits}g}]"


def make_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Table:
    """Table with right-aligned columns after the first."""
    table = Table(title=escape(title), title_justify="left")
    for number, column in enumerate(columns):
        table.add_column(escape(column), justify="left" if number == 0 else "right")
    for row in rows:
        table.add_row(*[escape(cell) if isinstance(cell, str) else f"{cell:.4g}" for cell in row])
    return table


@contextmanager
def stopwatch() -> Iterator[list[float]]:
    """A list that receives the seconds that the block took."""
    seconds: list[float] = []
    started = time.perf_counter()
    yield seconds
    seconds.append(time.perf_counter() - started)


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def set_threads(threads: int) -> None:
    """Number of threads of all libraries in this process."""
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far [MiB].

    Linux hands `ru_maxrss` of a parent down to the program that its child starts, so `VmHWM` is asked first.
    """
    status = Path("/proc/self/status")
    if status.exists():
        lines = (line.split() for line in status.read_text().splitlines())
        return next(float(words[1]) for words in lines if words and words[0] == "VmHWM:") / 1024.0
    import resource  # not on Windows

    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return used / (1 << 20) if sys.platform == "darwin" else used / 1024.0


def describe_machine() -> dict[str, object]:
    """Processor, cores, threads, versions and commit."""
    return {
        "processor": _processor(),
        "cores": available_cores(),
        "threads": torch.get_num_threads(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "cloudfit": __version__,
        "versions": {name: _version(name) for name in PACKAGES},
        "commit": _git("rev-parse", "HEAD"),
        "uncommitted_changes": bool(_git("status", "--porcelain", "--untracked-files=no")),
        "load_average": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def _git(*arguments: str) -> str | None:
    try:
        run = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return run.stdout.strip()


def add_volume_argument(parser: argparse.ArgumentParser) -> None:
    """Option --volume."""
    parser.add_argument(
        "--volume",
        type=Path,
        help="density volume; without it the Disney cloud of the shared data if it is there, else the procedural cumulus",
    )


def add_jobs_argument(parser: argparse.ArgumentParser) -> None:
    """Option --jobs."""
    parser.add_argument("--jobs", type=int, default=available_cores(), help="processes of one thread each")


def add_output_argument(parser: argparse.ArgumentParser, what: str) -> None:
    """Option --out."""
    parser.add_argument("--out", type=Path, help=what)


def scene_of(arguments: argparse.Namespace, width: int, height: int) -> tuple[Scene, str]:
    """Scene of the benchmarks with a camera of the given size, and the name of its volume; quick runs take a small cumulus."""
    path: Path | None = arguments.volume
    if path is None and not arguments.quick and SHARED_VOLUME.exists():
        path = SHARED_VOLUME
    grid = build_cumulus(QUICK_RESOLUTION) if path is None and arguments.quick else load_volume(path)
    name = "procedural cumulus" if path is None else path.stem
    z, y, x = grid.density.shape
    return scene_with(grid, path, width, height), f"{name} ({x} x {y} x {z} voxels)"


def scene_with(grid: DensityGrid, path: Path | None, width: int, height: int) -> Scene:
    """A volume under the sun of the benchmarks."""
    sun = radians_from_degrees(SUN_AZIMUTH_DEG), radians_from_degrees(SUN_ELEVATION_DEG)
    return Scene(grid, path, frame_volume(grid, width=width, height=height), *sun)


def tell_progress(message: str) -> None:
    """A line on stderr."""
    print(message, file=sys.stderr, flush=True)


def publish(name: str, question: str, quick: bool, outcome: Outcome, file: Path | None) -> None:
    """Print the tables and notes on stdout, and write everything to a JSON file if one is given."""
    machine = describe_machine()
    console = Console(width=160 if not sys.stdout.isatty() else None)
    for table in outcome.tables:
        console.print(table)
    for note in outcome.notes:
        console.print(f"- {note}", markup=False, highlight=False)
    console.print(
        f"{machine['processor']}, {machine['threads']} of {machine['cores']} cores, torch {torch.__version__}, "
        f"commit {str(machine['commit'])[:10]}{' with uncommitted changes' if machine['uncommitted_changes'] else ''}",
        markup=False,
        highlight=False,
    )
    if file is None:
        return
    document = {
        "benchmark": name,
        "question": question,
        "quick": quick,
        # Where on this machine something lies is nobody's business.
        "command": [
            "python",
            "-m",
            "benchmarks",
            *(Path(a).name if Path(a).is_absolute() else a for a in sys.argv[1:]),
        ],
        "date": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "machine": machine,
        "notes": list(outcome.notes),
        **outcome.values,
    }
    with atomic_path(file) as temporary:
        temporary.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
