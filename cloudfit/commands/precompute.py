"""`cloudfit precompute`: fill the store of scattering tables for a scene, so that later fits start at once."""

from pathlib import Path
from typing import Annotated

import typer

from cloudfit.commands import options as o
from cloudfit.commands.console import EXIT_CODES, Speaker, print_json, reported_errors

EPILOG = f"""Examples:

cloudfit precompute --volume cloud.vol --tables tables/

cloudfit fit photos/ --volume cloud.vol --tables tables/

{EXIT_CODES}"""

TablesFolder = Annotated[Path, typer.Option(help="Folder of the tables; made if needed.", rich_help_panel=o.RUN)]

MaxSeconds = Annotated[
    float | None,
    typer.Option(
        min=0.001,
        help="After which no further pass of paths begins, whatever error is left; the parts that need no paths come on top.",
        rich_help_panel=o.SEARCH,
    ),
]


def precompute(
    volume: o.Volume = None,
    tables: TablesFolder = Path("cloudfit-results/.tables"),
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
    max_seconds: MaxSeconds = None,
    seed: o.Seed = 0,
    quiet: o.Quiet = False,
    json: o.AsJson = False,
) -> None:
    """Precompute the scattering tables of a scene.

    A fit with the same volume, camera, sun, quality, optical depths and seed loads them instead of computing them.
    """
    speaker = Speaker(quiet)
    choice = o.SceneChoice(
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
    with reported_errors(speaker, "run the same command again"):
        from cloudfit.batch import available_cores, limit_threads
        from cloudfit.stack import prepare_stack
        from cloudfit.stack_report import describe_groups

        limit_threads(available_cores())
        speaker.say(f"precomputing {choice.describe()}")
        with speaker.progress() as bars:
            preset = o.choose_quality(quality, tolerance).limited(max_seconds)
            stack, report = prepare_stack(choice.load(), preset, seed, tables, bars.stage, optical_depths)
        usable = float(stack.usable.float().mean())
        if json:
            print_json(
                {
                    "schema": "cloudfit precompute 1",
                    "file": str(report.path),
                    "seconds": report.seconds,
                    "reused": report.reused,
                    "usable_nodes": usable,
                    "groups": stack.tables.groups,
                }
            )
            return
        for sentence in describe_groups(stack.tables.groups):
            speaker.say(sentence)
        speaker.say(
            f"{'loaded' if report.reused else 'built'} in {report.seconds:.1f} s; "
            f"{usable:.0%} of the nodes meet the accepted error"
        )
        print(report.path)
