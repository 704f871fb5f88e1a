"""`cloudfit demo`: the whole way on photographs that the project renders itself."""

from pathlib import Path
from typing import Annotated

import typer

from cloudfit.commands import options as o
from cloudfit.commands.console import EXIT_CODES, Speaker, reported_errors
from cloudfit.commands.fit import RESUME_HINT, run_batch, tell_report

EPILOG = f"""Examples:

cloudfit demo --out demo

{EXIT_CODES}"""

DEMO_WIDTH, DEMO_HEIGHT = 480, 360

Out = Annotated[Path, typer.Option(help="Folder of the example photographs and the results.")]


def demo(
    out: Out = Path("demo"),
    quality: o.Quality = o.QualityName.DRAFT,
    seed: o.Seed = 0,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    json: o.AsJson = False,
) -> None:
    """Fit the procedural cumulus to example photographs, and say where the page is.

    The examples are no real photographs: they were rendered by the reference path tracer under a simple sky.
    """
    speaker = Speaker(quiet, verbose)
    scene = o.SceneChoice(camera_width=DEMO_WIDTH, camera_height=DEMO_HEIGHT)
    search = o.SearchChoice(quality=quality, candidates=3, seed=seed)
    with reported_errors(speaker, RESUME_HINT):
        from cloudfit.batch import BatchSettings, available_cores, limit_threads
        from cloudfit.example_photographs import write_examples

        limit_threads(available_cores())
        examples = out / "photographs"
        photographs = write_examples(examples)
        speaker.say(f"{len(photographs)} example photographs, rendered by this project itself, are in {examples}")
        settings = BatchSettings(out / "results")
        report = run_batch(photographs, {}, scene, search, settings, speaker)
        raise typer.Exit(tell_report(report, settings, speaker, json))
