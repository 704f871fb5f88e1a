"""`cloudfit render`: a fitted result at any size, from any side, under any sun."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cloudfit.commands import options as o
from cloudfit.commands.console import EXIT_CODES, Speaker, print_json, reported_errors
from render.units import radians_from_degrees

if TYPE_CHECKING:
    from cloudfit.fit_types import Picture
    from cloudfit.scene import Scene

EPILOG = f"""Examples:

cloudfit render results/beach/result.json --out beach.png --width 1920 --height 1440

cloudfit render results/beach --candidate 2 --sun-elevation 5 --out evening.exr

cloudfit render results/beach --camera-azimuth 90 --out side.png

An .exr holds linear light: the image, and the layers single, multiple, ambient, sky and transmittance. {EXIT_CODES}"""

ResultFile = Annotated[Path, typer.Argument(help="A result.json, or the folder that holds it.", show_default=False)]
Picked = Annotated[int, typer.Option(min=1, help="Rank of the answer.")]
PictureFile = Annotated[Path, typer.Option(help="Picture to write, .png or .exr.")]
Width = Annotated[int | None, typer.Option(min=1, help="Pixels in a row; the rows follow unless given.")]
Height = Annotated[int | None, typer.Option(min=1, help="Rows.")]
OtherVolume = Annotated[Path | None, typer.Option(help="Take this volume instead of the fitted one.")]
Angle = Annotated[float | None, typer.Option(help="In degrees; without it as fitted.")]
Elevation = Annotated[float | None, typer.Option(min=-90, max=90, help="In degrees; without it as fitted.")]
Distance = Annotated[
    float | None, typer.Option(min=0, help="From the middle of the cloud, in metres; without it as fitted.")
]
OtherQuality = Annotated[o.QualityName | None, typer.Option(help="Effort; without it as fitted.")]
OtherSeed = Annotated[int | None, typer.Option(min=0, help="Of the random streams; without it as fitted.")]


def render(
    result: ResultFile,
    out: PictureFile = Path("picture.png"),
    candidate: Picked = 1,
    width: Width = None,
    height: Height = None,
    volume: OtherVolume = None,
    sun_azimuth: Angle = None,
    sun_elevation: Elevation = None,
    camera_azimuth: Angle = None,
    camera_elevation: Elevation = None,
    camera_fov: Annotated[
        float | None, typer.Option(min=0.1, max=179, help="In degrees; without it as fitted.")
    ] = None,
    camera_distance: Distance = None,
    quality: OtherQuality = None,
    seed: OtherSeed = None,
    quiet: o.Quiet = False,
    json: o.AsJson = False,
) -> None:
    """Render a fitted result again, at any size, from any side and under any sun."""
    speaker = Speaker(quiet)
    with reported_errors(speaker):
        from cloudfit.batch import available_cores, limit_threads
        from cloudfit.result import read_result
        from cloudfit.scene_record import scene_from_record, turn_camera

        _check_suffix(out)
        limit_threads(available_cores())
        document = read_result(result)
        fitted = _pick(document, candidate, result)
        scene = scene_from_record(document["scene"], volume)
        angles = [
            None if a is None else radians_from_degrees(a) for a in (camera_azimuth, camera_elevation, camera_fov)
        ]
        camera = turn_camera(_fitted_camera(scene), angles[0], angles[1], angles[2], camera_distance)
        camera = camera.resized(*_size(camera.width, camera.height, width, height))
        scene = replace(
            scene,
            camera=camera,
            sun_azimuth=scene.sun_azimuth if sun_azimuth is None else radians_from_degrees(sun_azimuth),
            sun_elevation=scene.sun_elevation if sun_elevation is None else radians_from_degrees(sun_elevation),
        )
        preset = quality.value if quality is not None else document["options"]["quality"]
        with speaker.progress() as bars:
            folder = result if result.is_dir() else result.parent
            picture = _render(
                scene,
                document,
                fitted,
                folder,
                preset,
                document["options"]["seed"] if seed is None else seed,
                bars.stage,
            )
        write_picture(out, picture)
        speaker.say(f"rendered in {picture.seconds:.1f} s, estimated noise {picture.image_error:.1%}")
        if json:
            print_json({"schema": "cloudfit picture 1", "file": str(out), "seconds": picture.seconds})
        else:
            print(out)


def write_picture(path: Path, picture: "Picture") -> None:
    """Write a picture as PNG, or as EXR with its layers. Raises ParameterError for another suffix."""
    from cloudfit.result_folder import picture_layers
    from render.image_files import write_exr, write_png

    _check_suffix(path)
    if path.suffix.lower() == ".exr":
        write_exr(path, picture_layers(picture))
    else:
        write_png(path, picture.rgb)


def _render(
    scene: "Scene", document: dict[str, Any], fitted: dict[str, Any], folder: Path, preset: str, seed: int, report: Any
) -> "Picture":
    import torch

    from cloudfit.picture import render_picture
    from cloudfit.quality import QUALITIES
    from render.errors import ResultError
    from render.image_files import read_exr_layers

    if preset not in QUALITIES:
        raise ResultError(f"{folder}: it was fitted with a quality of its own; choose one with --quality")
    sky = read_exr_layers(folder / document["files"].get("sky_linear", "sky.exr"))["rgb"]
    red, green, blue = fitted["air_depth"]
    return render_picture(
        scene,
        {name: parameter["value"] for name, parameter in fitted["parameters"].items()},
        (red, green, blue),
        torch.tensor(document["sunlight"]["colour"]),
        torch.tensor(fitted["ambient_colour"]),
        sky,
        QUALITIES[preset].picture_effort,
        seed,
        report,
    )


def _pick(document: dict[str, Any], rank: int, path: Path) -> dict[str, Any]:
    from render.errors import ResultError

    if document["status"] != "done":
        raise ResultError(
            f"{path}: there is nothing to render, for the photograph was not fitted: {document['reason']}"
        )
    candidates: list[dict[str, Any]] = document["candidates"]
    if rank > len(candidates):
        raise ResultError(f"{path}: expected a candidate out of 1 to {len(candidates)}, got {rank}")
    return candidates[rank - 1]


def _fitted_camera(scene: "Scene") -> Any:
    return scene.camera


def _size(fitted_width: int, fitted_height: int, width: int | None, height: int | None) -> tuple[int, int]:
    """Pixel counts; one that is not given keeps the shape of the picture."""
    if width is None and height is None:
        return fitted_width, fitted_height
    if width is None:
        width = max(1, round(fitted_width * (height or 1) / fitted_height))
    if height is None:
        height = max(1, round(fitted_height * width / fitted_width))
    return width, height


def _check_suffix(path: Path) -> None:
    from render.errors import ParameterError

    if path.suffix.lower() not in (".png", ".exr"):
        raise ParameterError(f"{path}: expected a name that ends in .png or .exr")
