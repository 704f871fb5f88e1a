"""`cloudfit fit`: photographs in, parameters and pictures out."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cloudfit.commands import options as o
from cloudfit.commands.console import (
    ALL_DONE,
    EXIT_CODES,
    INTERRUPTED,
    SOME_FAILED,
    Bars,
    Speaker,
    print_json,
    print_table,
    reported_errors,
    show,
)

if TYPE_CHECKING:
    from cloudfit.batch import BatchReport, BatchSettings
    from cloudfit.one_photograph import Outcome

RESUME_HINT = "run the same command again to go on; what is finished is kept"

EPILOG = f"""Examples:

cloudfit fit photos/ --volume cloud.vol --out results/

cloudfit fit beach.jpg --volume cloud.npz --sun-azimuth 220 --sun-elevation 40 --quality draft

cloudfit fit photos/ --volume cloud.vdb --mask masks/ --jobs 2 --json > results.json

cloudfit fit cirrus.jpg --volume cirrus.npz --optical-depths 0.01 2

{EXIT_CODES}"""

Photographs = Annotated[
    list[Path], typer.Argument(help="Photographs, or folders of them.", show_default=False, metavar="PHOTOS...")
]
Out = Annotated[Path, typer.Option(help="Folder of the results; made if needed.", rich_help_panel=o.RUN)]
Mask = Annotated[
    Path | None,
    typer.Option(
        help="Mask of the clouds, or a folder with a PNG of the same stem for each photograph. Grey levels: 255 cloud, "
        "170 sky, 85 neither, 0 find out; or just 0 and 255.",
        rich_help_panel=o.SCENE,
    ),
]
Jobs = Annotated[
    int, typer.Option(min=1, help="Photographs at the same time, each in a process of its own.", rich_help_panel=o.RUN)
]
Transfer = Annotated[
    o.TransferName,
    typer.Option(help="Display curve before the histograms; none compares raw intensities.", rich_help_panel=o.SEARCH),
]
Ambient = Annotated[
    o.AmbientName, typer.Option(help="Colour of the ambient light; free searches it.", rich_help_panel=o.SEARCH)
]
Optimiser = Annotated[
    str,
    typer.Option(
        help="Search method, such as screened_evolution, crs2_lm+sbplx, genetic, genetic_paper.",
        rich_help_panel=o.SEARCH,
    ),
]
Candidates = Annotated[int, typer.Option(min=1, help="Distinct answers to render and rank.", rich_help_panel=o.SEARCH)]
MaxSeconds = Annotated[
    float | None,
    typer.Option(
        min=0.001,
        help="Longest search for each photograph, in seconds; reading, tables and pictures come on top.",
        rich_help_panel=o.SEARCH,
    ),
]
MaxEvaluations = Annotated[
    int | None, typer.Option(min=1, help="Most candidates tried for each photograph.", rich_help_panel=o.SEARCH)
]
Searches = Annotated[
    int,
    typer.Option(
        min=1, help="Independent searches whose answers are pooled; they share the limits.", rich_help_panel=o.SEARCH
    ),
]
AirRefinements = Annotated[
    int,
    typer.Option(
        min=0,
        help="Times that the step of the search over the air is cut to a third; 0 is the paper's search.",
        rich_help_panel=o.SEARCH,
    ),
]
Loss = Annotated[
    str,
    typer.Option(
        help="What is made small: l1, correlation, chi_square, chi_square_symmetric, intersection, bhattacharyya, wasserstein, "
        "squared_difference (pixel by pixel), or soft_l1 and sorted_wasserstein, which have gradients as well.",
        rich_help_panel=o.SEARCH,
    ),
]
CoarseAir = Annotated[
    bool,
    typer.Option(
        "--coarse-air/--full-air",
        help="Begin the search over the air with every third of the paper's 11 depths, or with all.",
        rich_help_panel=o.SEARCH,
    ),
]
SearchPixels = Annotated[
    int,
    typer.Option(
        min=0,
        help="Pixels of the cloud that the search sees, at least; what it finds is settled on all of them. 0: it sees all.",
        rich_help_panel=o.SEARCH,
    ),
]
Resume = Annotated[
    bool,
    typer.Option(
        "--resume/--force", help="Keep what an earlier run has finished, or fit it again.", rich_help_panel=o.RUN
    ),
]


def fit(
    photographs: Photographs,
    volume: o.Volume = None,
    out: Out = Path("cloudfit-results"),
    mask: Mask = None,
    sun_azimuth: o.SunAzimuth = o.DEFAULT_SUN_AZIMUTH,
    sun_elevation: o.SunElevation = o.DEFAULT_SUN_ELEVATION,
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
    optimiser: Optimiser = o.DEFAULT_OPTIMISER,
    candidates: Candidates = 3,
    searches: Searches = 3,
    air_refinements: AirRefinements = o.DEFAULT_AIR_REFINEMENTS,
    loss: Loss = o.DEFAULT_LOSS,
    coarse_air: CoarseAir = False,
    search_pixels: SearchPixels = o.DEFAULT_SEARCH_PIXELS,
    max_seconds: MaxSeconds = None,
    max_evaluations: MaxEvaluations = None,
    seed: o.Seed = 0,
    jobs: Jobs = 1,
    resume: Resume = True,
    tables: o.Tables = None,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    json: o.AsJson = False,
) -> None:
    """Fit the rendering parameters of a cloud volume to photographs.

    Each photograph gets a folder with its parameters (result.json), pictures and a page; index.html in --out shows them all.
    """
    speaker = Speaker(quiet, verbose)
    scene = o.SceneChoice(
        volume,
        sun_azimuth,
        sun_elevation,
        camera_azimuth,
        camera_elevation,
        camera_fov,
        camera_distance,
        camera_width,
        camera_height,
        camera_type,
    )
    search = o.SearchChoice(
        quality,
        ambient,
        transfer,
        optimiser,
        max_evaluations,
        max_seconds,
        candidates,
        seed,
        searches,
        air_refinements,
        tolerance,
        loss,
        coarse_air,
        search_pixels,
        optical_depths,
    )
    with reported_errors(speaker, RESUME_HINT):
        from cloudfit.batch import BatchSettings
        from cloudfit.photograph import list_photographs

        files = list_photographs(photographs)
        settings = BatchSettings(out, tables, not resume, jobs)
        report = run_batch(files, find_masks(mask, files), scene, search, settings, speaker)
        raise typer.Exit(tell_report(report, settings, speaker, json))


def find_masks(mask: Path | None, photographs: Sequence[Path]) -> dict[Path, Path]:
    """Mask of each photograph that has one.

    Args:
        mask: a file for a single photograph, or a folder with a PNG of the same stem for some of them.
        photographs: files.

    Raises:
        InputError: it does not exist, no photograph has one, or one file should serve several photographs.
    """
    from render.errors import InputError

    if mask is None:
        return {}
    if mask.is_dir():
        found = {photo: file for photo in photographs if (file := mask / f"{photo.stem}.png").is_file()}
        if not found:
            raise InputError(f"{mask}: expected a PNG with the stem of a photograph, such as {photographs[0].stem}.png")
        return found
    if not mask.is_file():
        raise InputError(f"{mask}: no such mask; check the name")
    if len(photographs) > 1:
        raise InputError(f"{mask}: one mask for {len(photographs)} photographs; give a folder with one for each")
    return {photographs[0]: mask}


def run_batch(
    photographs: Sequence[Path],
    masks: dict[Path, Path],
    scene: o.SceneChoice,
    search: o.SearchChoice,
    settings: "BatchSettings",
    speaker: Speaker,
) -> "BatchReport":
    """Fit photographs with progress bars on stderr."""
    from cloudfit.batch import available_cores, fit_folder, limit_threads

    limit_threads(available_cores())
    options = search.options()
    speaker.say(f"fitting {scene.describe()} to {len(photographs)} photograph{'s' if len(photographs) > 1 else ''}")
    loaded = scene.load()
    with speaker.progress(len(photographs)) as bars:
        return fit_folder(photographs, loaded, options, settings, masks, Watcher(speaker, bars))


class Watcher:
    """Tells the user what a batch does."""

    def __init__(self, speaker: Speaker, bars: Bars) -> None:
        self._speaker, self._bars = speaker, bars

    def planned(self, total: int, kept: int) -> None:
        """Say what an earlier run has done."""
        if kept == total:
            self._speaker.say(
                "nothing to do: every photograph has been done with just these options (--force fits again)"
            )
        elif kept:
            self._speaker.say(f"{kept} of {total} photographs have been done before and are kept")

    def stage(self, subject: str, stage: str, share: float) -> None:
        """Move the bar."""
        self._bars.stage(f"{subject}: {stage}", share)

    def finished(self, outcome: "Outcome") -> None:
        """One line for each photograph."""
        self._bars.finished()
        if outcome.kept:
            return
        name = outcome.job.photograph.name
        if outcome.status == "done":
            self._speaker.say(
                f"{name}: loss {show(outcome.loss, '.3f')} (floor {show(outcome.floor, '.3f')}), "
                f"{show(outcome.wasserstein, '.1f')} grey levels away, {show(outcome.seconds, '.1f')} s"
            )
        elif outcome.status == "no_cloud":
            self._speaker.say(f"{name}: no cloud")
        else:
            self._speaker.warn(str(outcome.reason))
        if outcome.details and self._speaker.verbose:
            self._speaker.say(outcome.details)


def tell_report(report: "BatchReport", settings: "BatchSettings", speaker: Speaker, as_json: bool) -> int:
    """Print the table, or JSON, of a batch; returns the exit code."""
    if as_json:
        print_json(describe_report(report, settings))
    else:
        headings = ["photograph", "status", "loss", "floor", "levels away", "seconds", "peak MiB"]
        print_table(headings, [_row(outcome) for outcome in report.outcomes], left=2)
        print(f"page: {report.page}")
    if report.interrupted:
        speaker.say(f"interrupted after {len(report.outcomes)} photographs; {RESUME_HINT}")
        return INTERRUPTED
    return SOME_FAILED if report.count("failed") else ALL_DONE


def describe_report(report: "BatchReport", settings: "BatchSettings") -> dict[str, Any]:
    """The report as JSON."""
    return {
        "schema": "cloudfit batch 1",
        "out": str(settings.out),
        "page": str(report.page),
        "interrupted": report.interrupted,
        "done": report.count("done"),
        "no_cloud": report.count("no_cloud"),
        "failed": report.count("failed"),
        "stack": None
        if report.stack is None
        else {
            "file": None if report.stack.path is None else str(report.stack.path),
            "seconds": report.stack.seconds,
            "reused": report.stack.reused,
        },
        "photographs": [
            {
                "file": str(outcome.job.photograph),
                "status": outcome.status,
                "reason": outcome.reason,
                "kept": outcome.kept,
                "interrupted": outcome.interrupted,
                "loss": outcome.loss,
                "floor": outcome.floor,
                "wasserstein_levels": outcome.wasserstein,
                "seconds": outcome.seconds,
                "peak_memory_mb": outcome.peak_memory_mb,
                "result": str(outcome.job.folder / "result.json"),
                "page": str(outcome.job.folder / "index.html"),
            }
            for outcome in report.outcomes
        ],
    }


def _row(outcome: "Outcome") -> list[str]:
    word = outcome.status.replace("_", " ") + (" (kept)" if outcome.kept else "")
    return [
        outcome.job.photograph.name,
        word + (" (interrupted)" if outcome.interrupted else ""),
        show(outcome.loss, ".3f"),
        show(outcome.floor, ".3f"),
        show(outcome.wasserstein, ".1f"),
        show(outcome.seconds, ".1f"),
        show(outcome.peak_memory_mb, ".0f"),
    ]
