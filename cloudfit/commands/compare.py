"""`cloudfit compare`: which search method is best on your photographs, volumes and suns."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cloudfit.commands import options as o
from cloudfit.commands.console import (
    ALL_DONE,
    INTERRUPTED,
    SOME_FAILED,
    Bars,
    Speaker,
    print_json,
    print_table,
    reported_errors,
    show,
)
from cloudfit.commands.fit import AirRefinements, Ambient, CoarseAir, Loss, Mask, Transfer, find_masks

if TYPE_CHECKING:
    from cloudfit.comparison.compare import Comparison
    from cloudfit.comparison.problems import ProblemSource
    from cloudfit.comparison.run_record import RunRecord
    from cloudfit.fit_types import FitOptions
    from cloudfit.optimisers import Minimiser

RESUME_HINT = "run the same command again to go on; the runs that are finished are kept"

EPILOG = f"""Examples:

cloudfit compare --synthetic 4 --method genetic --method crs2_lm+sbplx --out comparison/

cloudfit compare photos/ --volume cloud.vol --volume other.vol --sun 220,40 --sun 90,20

cloudfit compare photos/ --volume cloud.vol --seeds 30 --max-evaluations 3000 --json > comparison.json

A run that is finished is never done again: add photographs, methods or seeds, and only what is new is run.

Exit codes: 0 all done, 1 some runs failed or photographs could not be used, 2 wrong usage, 3 bad input, {INTERRUPTED} interrupted."""

Photographs = Annotated[
    list[Path] | None,
    typer.Argument(help="Photographs, or folders of them.", show_default=False, metavar="[PHOTOS]..."),
]
Volumes = Annotated[
    list[Path] | None,
    typer.Option(
        "--volume",
        help="Density volume; repeat it for several. Without it a procedural cumulus.",
        show_default=False,
        rich_help_panel=o.SCENE,
    ),
]
Suns = Annotated[
    list[str] | None,
    typer.Option(
        "--sun",
        help="Azimuth and elevation of the sun in degrees, such as 220,40; repeat it for several.",
        show_default="220,40",
        rich_help_panel=o.SCENE,
    ),
]
Synthetic = Annotated[
    int,
    typer.Option(
        min=0,
        help="So many photographs for each volume and sun composed from the tables at known parameters.",
        rich_help_panel=o.SCENE,
    ),
]
Methods = Annotated[
    list[str] | None,
    typer.Option(
        "--method",
        help="Search method, such as crs2_lm+sbplx; repeat it for several. Without it all there are.",
        show_default=False,
        rich_help_panel=o.SEARCH,
    ),
]
Seeds = Annotated[int, typer.Option(min=1, help="Runs of each method on each problem.", rich_help_panel=o.SEARCH)]
FirstSeed = Annotated[int, typer.Option("--seed", min=0, help="First of the seeds.", rich_help_panel=o.RUN)]
MaxEvaluations = Annotated[int, typer.Option(min=2, help="Candidates that a run may try.", rich_help_panel=o.SEARCH)]
MaxSeconds = Annotated[
    float | None,
    typer.Option(min=0.001, help="Seconds that a run may take, beside that limit.", rich_help_panel=o.SEARCH),
]
Restarts = Annotated[
    bool,
    typer.Option(
        help="Start a method that ends of itself again from another seed while its budget lasts.",
        rich_help_panel=o.SEARCH,
    ),
]
Jobs = Annotated[
    int,
    typer.Option(
        min=1,
        help="Runs at the same time, each in a process of its own. They slow each other down: seconds are to be believed from one alone.",
        rich_help_panel=o.RUN,
    ),
]
Out = Annotated[Path, typer.Option(help="Folder of the runs and the report; made if needed.", rich_help_panel=o.RUN)]


def compare(
    photographs: Photographs = None,
    volume: Volumes = None,
    sun: Suns = None,
    synthetic: Synthetic = 0,
    mask: Mask = None,
    camera_azimuth: o.CameraAzimuth = 0.0,
    camera_elevation: o.CameraElevation = o.DEFAULT_CAMERA_ELEVATION,
    camera_fov: o.CameraFov = o.DEFAULT_FIELD_OF_VIEW,
    camera_distance: o.CameraDistance = None,
    camera_width: o.CameraWidth = o.DEFAULT_WIDTH,
    camera_height: o.CameraHeight = o.DEFAULT_HEIGHT,
    camera_type: o.CameraKind = o.CameraType.PINHOLE,
    quality: o.Quality = o.QualityName.STANDARD,
    tolerance: o.Tolerance = None,
    optical_depths: o.OpticalDepths = o.DEFAULT_OPTICAL_DEPTHS,
    transfer: Transfer = o.TransferName.SRGB,
    ambient: Ambient = o.AmbientName.SUN,
    air_refinements: AirRefinements = o.DEFAULT_AIR_REFINEMENTS,
    loss: Loss = o.DEFAULT_LOSS,
    coarse_air: CoarseAir = False,
    method: Methods = None,
    seeds: Seeds = 15,
    max_evaluations: MaxEvaluations = 1500,
    max_seconds: MaxSeconds = None,
    restarts: Restarts = True,
    seed: FirstSeed = 0,
    jobs: Jobs = 1,
    out: Out = Path("cloudfit-comparison"),
    tables: o.Tables = None,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    json: o.AsJson = False,
) -> None:
    """Compare search methods: every method on every photograph, volume and sun, from many seeds.

    Writes index.html with runtime distributions, data profiles, anytime areas and pictures, the same numbers as JSON and CSV, and a log
    for IOHanalyzer.
    """
    speaker = Speaker(quiet, verbose)
    view = o.SceneChoice(
        camera_azimuth=camera_azimuth,
        camera_elevation=camera_elevation,
        camera_fov=camera_fov,
        camera_distance=camera_distance,
        camera_width=camera_width,
        camera_height=camera_height,
        camera_type=camera_type,
    )
    search = o.SearchChoice(
        quality,
        ambient,
        transfer,
        air_refinements=air_refinements,
        tolerance=tolerance,
        loss=loss,
        coarse_air=coarse_air,
        optical_depths=optical_depths,
    )
    with reported_errors(speaker, RESUME_HINT):
        from cloudfit.batch import TABLES_NAME, available_cores, limit_threads
        from cloudfit.comparison.compare import Settings

        limit_threads(available_cores())
        scenes = list_scenes(view, volume or [], sun or [])
        stacks = tables if tables is not None else out / TABLES_NAME
        sources = list_problems(photographs or [], mask, scenes, synthetic, search.options(), stacks)
        settings = Settings(out, max_evaluations, max_seconds, seeds, seed, restarts, jobs)
        comparison = run_comparison(sources, choose_methods(method), settings, speaker)
        raise typer.Exit(tell_comparison(comparison, speaker, json))


def list_scenes(view: o.SceneChoice, volumes: Sequence[Path], suns: Sequence[str]) -> list[tuple[str, o.SceneChoice]]:
    """A scene for each volume and sun, with a name that says what tells it from the others.

    Raises:
        InputError: a sun is not two numbers.
    """
    scenes = []
    directions = [parse_sun(sun) for sun in suns] or [(o.DEFAULT_SUN_AZIMUTH, o.DEFAULT_SUN_ELEVATION)]
    files: list[Path | None] = [*volumes] or [None]
    for volume in files:
        for azimuth, elevation in directions:
            parts = [volume.stem] if volume is not None and len(files) > 1 else []
            parts += [f"sun{azimuth:g}_{elevation:g}"] if len(directions) > 1 else []
            choice = replace(view, volume=volume, sun_azimuth=azimuth, sun_elevation=elevation)
            scenes.append(("-".join(parts), choice))
    return scenes


def parse_sun(text: str) -> tuple[float, float]:
    """Azimuth and elevation in degrees, from a text such as 220,40. Raises InputError for anything else."""
    from render.errors import InputError

    try:
        azimuth, elevation = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"expected a sun as azimuth,elevation in degrees, such as 220,40, got {text!r}") from None
    if not -90.0 <= elevation <= 90.0:
        raise InputError(f"expected a sun no more than 90 degrees above or below the horizon, got {elevation:g}")
    return azimuth, elevation


def list_problems(
    photographs: Sequence[Path],
    mask: Path | None,
    scenes: Sequence[tuple[str, o.SceneChoice]],
    synthetic: int,
    options: "FitOptions",
    tables: Path,
) -> list["ProblemSource"]:
    """Every photograph in every scene, and so many composed ones for each scene.

    Raises:
        InputError: there is neither; a file does not exist.
        VolumeError, CameraError: a scene cannot be set up.
    """
    from cloudfit.comparison.problems import ComposedSource, PhotographSource, SceneSource
    from cloudfit.photograph import list_photographs
    from cloudfit.result_folder import folder_names
    from cloudfit.scene_record import describe_scene
    from render.errors import InputError

    files = list_photographs(photographs) if photographs else []
    if not files and not synthetic:
        raise InputError("there is nothing to compare on; give photographs, or --synthetic 4 for photographs made up")
    masks = find_masks(mask, files)
    names = folder_names(files)
    sources: list[ProblemSource] = []
    for suffix, choice in scenes:
        scene = SceneSource(describe_scene(choice.load()), options, tables)
        ending = f"-{suffix}" if suffix else ""
        sources += [PhotographSource(names[file] + ending, file, masks.get(file), scene) for file in files]
        sources += [ComposedSource(f"synthetic_{number:02d}{ending}", number, scene) for number in range(synthetic)]
    return sources


def choose_methods(names: Sequence[str] | None) -> dict[str, "Minimiser"]:
    """Methods by name, all of them without names. Raises ParameterError for one that there is not."""
    from cloudfit.optimisers import OPTIMISERS
    from render.errors import ParameterError

    for name in names or ():
        if name not in OPTIMISERS:
            raise ParameterError(f"no optimiser is called {name!r}; there are {', '.join(OPTIMISERS)}")
    return {name: OPTIMISERS[name] for name in names or OPTIMISERS}


def run_comparison(
    sources: Sequence["ProblemSource"], methods: dict[str, "Minimiser"], settings: Any, speaker: Speaker
) -> "Comparison":
    """Compare with progress bars on stderr."""
    from cloudfit.comparison.compare import compare as compare_methods

    total = len(sources) * len(methods) * settings.seeds
    words = [_count(len(methods), "method"), _count(len(sources), "problem"), _count(settings.seeds, "seed")]
    speaker.say(f"comparing {words[0]} on {words[1]} from {words[2]}: {_count(total, 'run')}")
    with speaker.progress(total, "runs") as bars:
        return compare_methods(sources, methods, settings, Watcher(speaker, bars))


class Watcher:
    """Tells the user what a comparison does."""

    def __init__(self, speaker: Speaker, bars: Bars) -> None:
        self._speaker, self._bars = speaker, bars

    def planned(self, total: int, kept: int) -> None:
        """Say what an earlier call has done."""
        if kept:
            self._speaker.say(f"{kept} of {total} runs have been done before and are kept")
            self._bars.finished(kept)

    def stage(self, subject: str, share: float) -> None:
        """Move the bar."""
        self._bars.stage(subject, share)

    def finished(self, record: "RunRecord") -> None:
        """Count the run; a failure is said at once."""
        self._bars.finished()
        if record.failed and not record.refused:
            self._speaker.warn(f"{record.method} on {record.problem}, seed {record.seed}: {record.message}")


def tell_comparison(comparison: "Comparison", speaker: Speaker, as_json: bool) -> int:
    """Print the ranking, or JSON; returns the exit code."""
    report = comparison.report
    for name, reason in comparison.refused.items():
        speaker.warn(f"{name} is left out: {reason}")
    for name, reason in report.refused.items():
        speaker.say(f"{name} is left out: {reason}")
    if report.interrupted:
        speaker.say(f"interrupted after {len(report.runs)} of {report.total} runs; {RESUME_HINT}")
        return INTERRUPTED
    if as_json:
        print_json(
            {**comparison.document, "page": str(comparison.page), "refused": {**comparison.refused, **report.refused}}
        )
    else:
        methods = {row["method"]: row for row in comparison.document["methods"]}
        headings = ["method", "area", "area, seconds", "success", "median excess", "evaluations", "seconds", "overhead"]
        print_table(headings, [_row(methods[name]) for name in comparison.document["ranking_by_evaluations"]])
        print(f"page: {comparison.page}")
    return SOME_FAILED if report.failed or comparison.refused else ALL_DONE


def _row(method: dict[str, Any]) -> list[str]:
    return [
        method["method"],
        show(method["aocc_evaluations"], ".3f"),
        show(method["aocc_seconds"], ".3f"),
        show(method["success_rate"], ".0%"),
        show(method["excess"]["median"], ".1%"),
        show(method["evaluations"], ".0f"),
        show(method["seconds"], ".2f"),
        show(method["overhead_seconds"], ".2f"),
    ]


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
