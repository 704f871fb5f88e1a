"""`cloudfit render`: a fitted result at any size, from any side, under any sun."""

import enum
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cloudfit.commands import options as o
from cloudfit.commands.console import EXIT_CODES, Speaker, print_json, reported_errors
from render.units import radians_from_degrees

if TYPE_CHECKING:
    from torch import Tensor

    from cloudfit.fit_types import Picture
    from cloudfit.scene import Scene

EPILOG = f"""Examples:

cloudfit render results/beach/result.json --out beach.png --width 1920 --height 1440

cloudfit render results/beach --candidate 2 --sun-elevation 5 --out evening.exr

cloudfit render results/beach --camera-azimuth 90 --out side.png

cloudfit render results/beach --sky atmosphere --cloud-albedo 1 --sun-elevation 4 --out dusk.png

An .exr holds linear light: the image, and the layers single, multiple, ambient, sky and transmittance; with --sky
atmosphere in cd/m^2. {EXIT_CODES}"""

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


class SkyName(enum.StrEnum):
    """What stands behind the cloud, lights it and lies in front of it."""

    PHOTOGRAPH = "photograph"
    ATMOSPHERE = "atmosphere"


AIR = "With --sky atmosphere"
Sky = Annotated[
    SkyName, typer.Option(help="The photograph's sky, light and haze, or those of the clear atmosphere of the Earth.")
]
CloudDistance = Annotated[
    float | None,
    typer.Option(
        help="Of the cloud from the viewer, in metres. Without it as far as the camera is from it.", rich_help_panel=AIR
    ),
]
Altitude = Annotated[float, typer.Option(min=0, help="Of the viewer above the ground, in metres.", rich_help_panel=AIR)]
Aerosol = Annotated[
    float, typer.Option(min=0, help="Haze: so many times the aerosol of clear air.", rich_help_panel=AIR)
]
CloudAlbedo = Annotated[
    float | None,
    typer.Option(
        min=0,
        max=1,
        help="Of the droplets; water has 1. Without it as fitted, where it may have made up for the sunlight.",
        rich_help_panel=AIR,
    ),
]
Exposure = Annotated[float, typer.Option(help="Brighter by so many stops than automatic.", rich_help_panel=AIR)]
TablesFolder = Annotated[
    Path | None,
    typer.Option(help="Folder of the sky's tables. Without it .tables beside the picture.", rich_help_panel=AIR),
]


@dataclass(frozen=True)
class SkyChoice:
    """The atmosphere as the user states it: metres and shares."""

    cloud_distance: float | None
    altitude: float
    aerosol: float
    albedo: float | None
    folder: Path


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
    sky: Sky = SkyName.PHOTOGRAPH,
    cloud_distance: CloudDistance = None,
    altitude: Altitude = 2.0,
    aerosol: Aerosol = 1.0,
    cloud_albedo: CloudAlbedo = None,
    exposure: Exposure = 0.0,
    tables: TablesFolder = None,
    quiet: o.Quiet = False,
    json: o.AsJson = False,
) -> None:
    """Render a fitted result again, at any size, from any side and under any sun."""
    speaker = Speaker(quiet)
    with reported_errors(speaker):
        from cloudfit.batch import TABLES_NAME, available_cores, limit_threads
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
        number = document["options"]["seed"] if seed is None else seed
        folder = tables if tables is not None else out.parent / TABLES_NAME
        air = SkyChoice(cloud_distance, altitude, aerosol, cloud_albedo, folder)
        with speaker.progress() as bars:
            if sky is SkyName.ATMOSPHERE:
                picture = _render_in_atmosphere(scene, fitted, air, preset, number, bars.stage)
            else:
                home = result if result.is_dir() else result.parent
                picture = _render(scene, document, fitted, home, preset, number, bars.stage)
        write_picture(out, picture, exposure if sky is SkyName.ATMOSPHERE else None)
        speaker.say(f"rendered in {picture.seconds:.1f} s, estimated noise {picture.image_error:.1%}")
        if json:
            print_json({"schema": "cloudfit picture 1", "file": str(out), "seconds": picture.seconds})
        else:
            print(out)


def write_picture(path: Path, picture: "Picture", exposure: float | None = None) -> None:
    """Write a picture as PNG, or as EXR with its layers.

    Args:
        path: of the file.
        picture: relative to display white, or in cd/m^2.
        exposure: of a picture in cd/m^2, in stops over automatic; None for one that needs none.

    Raises:
        ParameterError: for another suffix.
    """
    from cloudfit.result_folder import picture_layers
    from render.image_files import write_exr, write_png

    _check_suffix(path)
    if path.suffix.lower() == ".exr":
        write_exr(path, picture_layers(picture))
    else:
        write_png(path, picture.rgb if exposure is None else _exposed(picture.rgb, exposure))


def _exposed(rgb: "Tensor", exposure: float) -> "Tensor":
    from render.atmosphere.sky_image import choose_white, show_sky

    return show_sky(rgb, choose_white(rgb), exposure)


def _render_in_atmosphere(
    scene: "Scene", fitted: dict[str, Any], air: SkyChoice, preset: str, seed: int, report: Any
) -> "Picture":
    from cloudfit.atmosphere_picture import CloudPlace, render_in_atmosphere
    from cloudfit.quality import QUALITIES
    from cloudfit.sky_models import WAVELENGTHS, prepare_sky
    from render.atmosphere.earth import earth

    quality = _find_quality(preset)
    place = CloudPlace(air.altitude, air.cloud_distance)
    atmosphere = earth(WAVELENGTHS).with_aerosol(air.aerosol)
    place.point(scene.camera, atmosphere.bottom_radius)  # refuses before anything takes long
    model, _ = prepare_sky("accurate", atmosphere, quality, air.folder, report)
    parameters = {name: parameter["value"] for name, parameter in fitted["parameters"].items()}
    if air.albedo is not None:
        parameters["albedo"] = air.albedo
    return render_in_atmosphere(scene, parameters, model, place, QUALITIES[quality].picture_effort, seed, report)


def _find_quality(preset: str) -> str:
    from cloudfit.quality import QUALITIES
    from render.errors import ResultError

    if preset not in QUALITIES:
        raise ResultError("the result was fitted with a quality of its own; choose one with --quality")
    return preset


def _render(
    scene: "Scene", document: dict[str, Any], fitted: dict[str, Any], folder: Path, preset: str, seed: int, report: Any
) -> "Picture":
    import torch

    from cloudfit.picture import render_picture
    from cloudfit.quality import QUALITIES
    from render.image_files import read_exr_layers

    quality = QUALITIES[_find_quality(preset)]
    sky = read_exr_layers(folder / document["files"].get("sky_linear", "sky.exr"))["rgb"]
    red, green, blue = fitted["air_depth"]
    return render_picture(
        scene,
        {name: parameter["value"] for name, parameter in fitted["parameters"].items()},
        (red, green, blue),
        torch.tensor(document["sunlight"]["colour"]),
        torch.tensor(fitted["ambient_colour"]),
        sky,
        quality.picture_effort,
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
