"""`cloudfit sky`: the clear sky from any altitude, under any sun."""

import enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cloudfit.commands import options as o
from cloudfit.commands.console import EXIT_CODES, Speaker, print_json, reported_errors
from render.units import radians_from_degrees

if TYPE_CHECKING:
    from torch import Tensor

    from cloudfit.sky_models import SkyModel

EPILOG = f"""Examples:

cloudfit sky --sun-elevation 40 --out noon.png

cloudfit sky --altitude 9000 --sun-elevation 5 --sun-azimuth 0 --out evening.exr

cloudfit sky --panorama --width 1024 --aerosol 5 --out hazy.png

cloudfit sky --sweep-sun 12 --width 240 --height 160 --out day.png

The tables are built once for each amount of aerosol, in half a minute (--mode parity: a minute or two), and kept. An
.exr holds linear sRGB in cd/m^2. {EXIT_CODES}"""


class SkyMode(enum.StrEnum):
    """Models of the sky; the same names as in `cloudfit.sky_models.SKY_MODES`."""

    ACCURATE = "accurate"
    PARITY = "parity"


PictureFile = Annotated[Path, typer.Option(help="Picture to write, .png or .exr.", rich_help_panel=o.RUN)]
Altitude = Annotated[
    float, typer.Option(min=0, help="Of the camera above the ground, in metres.", rich_help_panel=o.CAMERA)
]
Aerosol = Annotated[
    float, typer.Option(min=0, help="Haze: so many times the aerosol of clear air.", rich_help_panel=o.SCENE)
]
Albedo = Annotated[float, typer.Option(min=0, max=1, help="Of the ground.", rich_help_panel=o.SCENE)]
Exposure = Annotated[
    float, typer.Option(help="Brighter by so many stops than automatic, or than --white.", rich_help_panel=o.CAMERA)
]
White = Annotated[
    float | None,
    typer.Option(
        min=1e-9,
        help="Luminance shown as light grey, in cd/m^2. Without it a tenth of the pixels is brighter.",
        rich_help_panel=o.CAMERA,
    ),
]
Panorama = Annotated[
    bool,
    typer.Option(
        "--panorama", help="All around, zenith on top; the height is half the width.", rich_help_panel=o.CAMERA
    ),
]
SweepSun = Annotated[
    int | None,
    typer.Option(
        min=2,
        max=100,
        help="A sheet of so many pictures, the sun from 60 degrees down to -12.",
        rich_help_panel=o.SCENE,
    ),
]
Wide = Annotated[int, typer.Option("--width", min=1, help="Pixels in a row.", rich_help_panel=o.CAMERA)]
High = Annotated[int, typer.Option("--height", min=1, help="Rows.", rich_help_panel=o.CAMERA)]
Mode = Annotated[
    SkyMode,
    typer.Option(
        help="Integrals to a stated tolerance, or the numbers of Bruneton's reference.", rich_help_panel=o.SEARCH
    ),
]
TablesFolder = Annotated[
    Path | None,
    typer.Option(help="Folder of the tables. Without it .tables beside the picture.", rich_help_panel=o.RUN),
]

SWEEP_HIGHEST, SWEEP_LOWEST = 60.0, -12.0


def sky(
    out: PictureFile = Path("sky.png"),
    altitude: Altitude = 2.0,
    sun_azimuth: o.SunAzimuth = 30.0,
    sun_elevation: o.SunElevation = o.DEFAULT_SUN_ELEVATION,
    aerosol: Aerosol = 1.0,
    ground_albedo: Albedo = 0.1,
    camera_azimuth: o.CameraAzimuth = 0.0,
    camera_elevation: o.CameraElevation = 15.0,
    camera_fov: o.CameraFov = 60.0,
    width: Wide = o.DEFAULT_WIDTH,
    height: High = o.DEFAULT_HEIGHT,
    exposure: Exposure = 0.0,
    white: White = None,
    panorama: Panorama = False,
    sweep_sun: SweepSun = None,
    mode: Mode = SkyMode.ACCURATE,
    quality: o.Quality = o.QualityName.STANDARD,
    tables: TablesFolder = None,
    quiet: o.Quiet = False,
    json: o.AsJson = False,
) -> None:
    """Picture the clear sky, with ground and sun, from the ground to space."""
    speaker = Speaker(quiet)
    with reported_errors(
        speaker, "run the same command again; in the mode parity finished orders of scattering are kept"
    ):
        from cloudfit.batch import TABLES_NAME, available_cores, limit_threads
        from cloudfit.sky_models import WAVELENGTHS, prepare_sky
        from render.atmosphere.earth import earth

        _check_suffix(out)
        limit_threads(available_cores())
        height = max(1, width // 2) if panorama else height
        directions = _directions(panorama, camera_azimuth, camera_elevation, camera_fov, width, height)
        folder = tables if tables is not None else out.parent / TABLES_NAME
        atmosphere = earth(WAVELENGTHS, ground_albedo=ground_albedo).with_aerosol(aerosol)
        with speaker.progress() as bars:
            model, report = prepare_sky(mode.value, atmosphere, quality.value, folder, bars.stage)
        speaker.say(f"tables {'loaded' if report.reused else 'built'} in {report.seconds:.1f} s")
        elevations = [sun_elevation] if sweep_sun is None else _sweep(sweep_sun)
        pictures = [_picture(model, altitude, directions, sun_azimuth, e, height) for e in elevations]
        whites = (
            [_write_sky(out, pictures, white, exposure)]
            if sweep_sun is None
            else _write_sheet(out, pictures, white, exposure)
        )
        if json:
            document = {
                "schema": "cloudfit sky 1",
                "file": str(out),
                "mode": mode.value,
                "tables": str(report.path),
                "reused": report.reused,
            }
            print_json({**document, "sun_elevation_deg": elevations, "white_cd_m2": whites})
        else:
            print(out)


def _sweep(count: int) -> list[float]:
    """Elevations of the sun in degrees, from high to low."""
    return [SWEEP_HIGHEST + (SWEEP_LOWEST - SWEEP_HIGHEST) * number / (count - 1) for number in range(count)]


def _directions(
    panorama: bool, azimuth: float, elevation: float, field_of_view: float, width: int, height: int
) -> "Tensor":
    """Rays of the camera `(pixel, 3)`."""
    from render.atmosphere.sky_image import panorama_directions
    from render.camera import PinholeCamera, direction_from_angles

    camera = PinholeCamera(
        position=(0.0, 0.0, 0.0),
        target=direction_from_angles(radians_from_degrees(azimuth), radians_from_degrees(elevation)),
        field_of_view=radians_from_degrees(field_of_view),
        width=width,
        height=height,
    )
    return panorama_directions(width, height) if panorama else camera.rays()[1]


def _picture(
    model: "SkyModel", altitude: float, directions: "Tensor", azimuth: float, elevation: float, height: int
) -> "Tensor":
    """Linear sRGB `(height, width, 3)` [cd/m^2]."""
    import torch

    from render.atmosphere.sky_image import colour_sky
    from render.camera import direction_from_angles

    sun = direction_from_angles(radians_from_degrees(azimuth), radians_from_degrees(elevation))
    radiance = model.compose(altitude, directions, torch.tensor(sun, dtype=torch.float64))
    return colour_sky(model.atmosphere, radiance).reshape(height, -1, 3)


def _write_sky(out: Path, pictures: list["Tensor"], white: float | None, exposure: float) -> float:
    """Write one picture; returns the luminance that is shown white."""
    from render.atmosphere.sky_image import choose_white, show_sky
    from render.image_files import write_exr, write_png

    shown = white if white is not None else choose_white(pictures[0])
    if out.suffix.lower() == ".exr":
        write_exr(out, {"rgb": pictures[0]})
    else:
        write_png(out, show_sky(pictures[0], shown, exposure))
    return shown


def _write_sheet(out: Path, pictures: list["Tensor"], white: float | None, exposure: float) -> list[float]:
    """Write pictures side by side in rows, each exposed by itself unless a white is given; returns their whites."""
    import math

    import torch

    from render.atmosphere.sky_image import choose_white, show_sky
    from render.image_files import write_exr, write_png

    columns = math.ceil(math.sqrt(len(pictures)))
    whites = [white if white is not None else choose_white(picture) for picture in pictures]
    cells: list[Any] = pictures
    if out.suffix.lower() != ".exr":
        cells = [show_sky(picture, shown, exposure) for picture, shown in zip(pictures, whites, strict=True)]
    cells = cells + [torch.zeros_like(cells[0])] * (-len(cells) % columns)
    rows = [torch.cat(cells[start : start + columns], 1) for start in range(0, len(cells), columns)]
    sheet = torch.cat(rows, 0)
    if out.suffix.lower() == ".exr":
        write_exr(out, {"rgb": sheet})
    else:
        write_png(out, sheet)
    return whites


def _check_suffix(path: Path) -> None:
    from render.errors import ParameterError

    if path.suffix.lower() not in (".png", ".exr"):
        raise ParameterError(f"{path}: expected a name that ends in .png or .exr")
