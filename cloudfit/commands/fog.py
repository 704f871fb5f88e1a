"""`cloudfit fog`: a plain, or your own picture with its depth, seen through fog."""

import enum
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cloudfit.commands import options as o
from cloudfit.commands.console import Speaker, print_json, reported_errors
from cloudfit.commands.fog_choice import FogChoice
from render.units import radians_from_degrees

if TYPE_CHECKING:
    from torch import Tensor

    from cloudfit.fog_picture import FoggyPicture
    from cloudfit.sky_models import SkyModel

EPILOG = """Examples:

cloudfit fog --out morning.png

cloudfit fog --medium linear --visibility 150 --fog-height 40 --eye-height 60 --sun-elevation 6 --out bank.png --out
bank.exr

cloudfit fog --sheet --medium exponential --visibility 2000 --fog-height 150 --out densities.png

cloudfit fog --atmosphere --sun-elevation 4 --out evening.png

cloudfit fog --image street.jpg --depth street.exr --visibility 200 --eye-height 2 --out foggy.png

Visibility is the meteorological optical range: the distance after which 5 % of the light is left. Below 1000 m it is
called fog, to 5000 m haze. An .exr holds linear light: the image, and the layers scattered, transmittance and
distance.

Exit codes: 0 all done, 2 wrong usage, 3 bad input, 130 interrupted."""

SHEET_FACTORS = (4.0, 1.0, 0.25)
"""Visibilities of a sheet, relative to that asked for."""

SUPERSAMPLING = 2
"""Rays across and down a pixel of the plain, whose edges would look like stairs."""

FOG, PICTURE = "Fog", "Picture"


class MediumName(enum.StrEnum):
    """Profiles; the same names as in `render.media.MEDIA`."""

    UNIFORM = "uniform"
    LINEAR = "linear"
    EXPONENTIAL = "exponential"


class DepthKind(enum.StrEnum):
    """What a depth map measures."""

    DISTANCE = "distance"
    Z = "z"


Medium = Annotated[
    MediumName, typer.Option(help="How the fog thins out with height: not, evenly, or by e.", rich_help_panel=FOG)
]
Visibility = Annotated[
    float, typer.Option(help="At the bottom of the fog, in metres; inf for none.", rich_help_panel=FOG)
]
FogHeight = Annotated[
    float, typer.Option(help="Where the fog ends, or thins out by e, above its base, in metres.", rich_help_panel=FOG)
]
FogBase = Annotated[
    float, typer.Option(help="Height of the bottom of the fog above the ground, in metres.", rich_help_panel=FOG)
]
Asymmetry = Annotated[
    float,
    typer.Option(
        min=-0.999, max=0.999, help="Mean cosine of scattering: droplets 0.85, haze 0.6.", rich_help_panel=FOG
    ),
]
Albedo = Annotated[
    float, typer.Option(min=0, max=1, help="Share of the light that is not absorbed.", rich_help_panel=FOG)
]
Colour = Annotated[
    str | None,
    typer.Option(help="Sunlight as red,green,blue. Without it white, through clear air.", rich_help_panel=o.SCENE),
]
Intensity = Annotated[float, typer.Option(min=0, help="Factor on the sunlight.", rich_help_panel=o.SCENE)]
Ambient = Annotated[
    float, typer.Option(min=0, help="Factor on the light that comes from everywhere.", rich_help_panel=o.SCENE)
]
SunElevation = Annotated[
    float, typer.Option(min=-90, max=90, help="Of the sun, in degrees; it may have set.", rich_help_panel=o.SCENE)
]
EyeHeight = Annotated[
    float, typer.Option(min=0, max=1e8, help="Of the eye above the ground, in metres.", rich_help_panel=o.CAMERA)
]
Exposure = Annotated[float, typer.Option(help="Stops by which the picture is brightened.", rich_help_panel=PICTURE)]
Image = Annotated[
    Path | None, typer.Option(help="Your picture, instead of the plain; needs --depth.", rich_help_panel=PICTURE)
]
Depth = Annotated[
    Path | None,
    typer.Option(help="Its depth in metres: .exr (channel Z, depth.Z, V, Y or R) or .npy.", rich_help_panel=PICTURE),
]
DepthMeaning = Annotated[
    DepthKind,
    typer.Option(help="Depth along the ray of the pixel, or along the axis of view.", rich_help_panel=PICTURE),
]
Sky = Annotated[
    Path | None, typer.Option(help="Picture behind the plain instead of a clear sky.", rich_help_panel=PICTURE)
]
Atmosphere = Annotated[
    bool,
    typer.Option(
        "--atmosphere",
        help="Put the clear atmosphere of the Earth behind the plain, and take its light; its tables are kept in .tables beside --out.",
        rich_help_panel=PICTURE,
    ),
]
Out = Annotated[
    list[Path] | None,
    typer.Option(
        help="File to write, .png or .exr; repeat it for both.", show_default="fog.png", rich_help_panel=PICTURE
    ),
]
Sheet = Annotated[
    bool,
    typer.Option(
        "--sheet",
        help="Three pictures side by side: 4 times the visibility, as asked, a quarter.",
        rich_help_panel=PICTURE,
    ),
]


def fog(
    out: Out = None,
    medium: Medium = MediumName.LINEAR,
    visibility: Visibility = 300.0,
    fog_height: FogHeight = 60.0,
    fog_base: FogBase = 0.0,
    asymmetry: Asymmetry = 0.7,
    albedo: Albedo = 0.99,
    sun_azimuth: o.SunAzimuth = 55.0,
    sun_elevation: SunElevation = 20.0,
    sun_colour: Colour = None,
    sun_intensity: Intensity = 1.0,
    ambient: Ambient = 1.0,
    eye_height: EyeHeight = 12.0,
    camera_azimuth: o.CameraAzimuth = 0.0,
    camera_elevation: o.CameraElevation = 3.0,
    camera_fov: o.CameraFov = 38.0,
    camera_width: o.CameraWidth = 960,
    camera_height: o.CameraHeight = 540,
    exposure: Exposure = 0.0,
    image: Image = None,
    depth: Depth = None,
    depth_kind: DepthMeaning = DepthKind.DISTANCE,
    sky: Sky = None,
    atmosphere: Atmosphere = False,
    sheet: Sheet = False,
    quiet: o.Quiet = False,
    json: o.AsJson = False,
) -> None:
    """See a plain with poles and hills, or your own picture with its depth, through fog lit by the sun.

    The light is exact for single scattering (docs/fog.md); what is scattered more than once is taken to come from
    everywhere.
    """
    speaker = Speaker(quiet)
    choice = FogChoice(
        medium=medium.value,
        visibility=visibility,
        fog_height=fog_height,
        fog_base=fog_base,
        asymmetry=asymmetry,
        albedo=albedo,
        sun_azimuth=sun_azimuth,
        sun_elevation=sun_elevation,
        sun_colour=sun_colour,
        sun_intensity=sun_intensity,
        ambient=ambient,
        eye_height=eye_height,
        camera_azimuth=camera_azimuth,
        camera_elevation=camera_elevation,
        camera_fov=camera_fov,
    )
    files = out or [Path("fog.png")]
    with reported_errors(speaker):
        from cloudfit.batch import available_cores, limit_threads

        check_files(files, image, depth, sky, atmosphere, sun_colour)
        limit_threads(available_cores())
        started = time.perf_counter()
        factors = SHEET_FACTORS if sheet else (1.0,)
        with speaker.progress() as bars:
            pictures = []
            air = prepare_air(files[0].parent, bars.stage) if atmosphere else None
            for number, factor in enumerate(factors):
                bars.stage("fog", number / len(factors))
                if image is not None and depth is not None:
                    pictures.append(fog_over_photograph(choice, factor, image, depth, depth_kind))
                else:
                    pictures.append(fog_over_plain(choice, factor, (camera_width, camera_height), sky, air))
        write_pictures(files, pictures, exposure)
        tell_fog(choice, factors, files, time.perf_counter() - started, speaker, json)


def check_files(
    files: list[Path],
    image: Path | None,
    depth: Path | None,
    sky: Path | None,
    atmosphere: bool = False,
    sun_colour: str | None = None,
) -> None:
    """Raise ParameterError for names of other kinds, or pictures that do not go together."""
    from render.errors import ParameterError

    for path in files:
        if path.suffix.lower() not in _WRITERS:
            raise ParameterError(f"{path}: expected a name that ends in {' or '.join(_WRITERS)}")
    if (image is None) != (depth is None):
        raise ParameterError("--image and --depth go together: fog needs to know how far away everything is")
    if image is not None and sky is not None:
        raise ParameterError("--sky is the sky of the plain; a picture given by --image has one of its own")
    if atmosphere and not (image is None and sky is None and sun_colour is None):
        raise ParameterError(
            "--atmosphere is the sky and the sun of the plain; leave --image, --sky and --sun-colour out"
        )


def prepare_air(folder: Path, on_progress: Any) -> "SkyModel":
    """The clear atmosphere of the Earth, its tables in a folder beside the picture."""
    from cloudfit.batch import TABLES_NAME
    from cloudfit.sky_models import WAVELENGTHS, prepare_sky
    from render.atmosphere.earth import earth

    return prepare_sky("accurate", earth(WAVELENGTHS), "standard", folder / TABLES_NAME, on_progress)[0]


def fog_over_plain(
    choice: FogChoice, factor: float, size: tuple[int, int], sky: Path | None, air: "SkyModel | None" = None
) -> "FoggyPicture":
    """The plain through fog of a multiple of the visibility, under a picture of a sky, an atmosphere or a gradient.

    Raises:
        ParameterError, CameraError: numbers without meaning.
        PhotographError: the sky cannot be read.
    """
    import cv2
    import torch

    from cloudfit.fog_picture import build_plain, put_fog
    from render.image_files import read_image

    width, height = size[0] * SUPERSAMPLING, size[1] * SUPERSAMPLING
    behind = None
    if sky is not None:
        behind = torch.from_numpy(
            cv2.resize(read_image(sky).pixels.numpy(), (width, height), interpolation=cv2.INTER_AREA)
        )
    medium, (sun, sunlight), around = choice.build_medium(factor), choice.sun(), None
    directions = choice.directions(width, height)
    if air is not None:
        from cloudfit.fog_sky import compose_fog_sky

        above = compose_fog_sky(air, choice.eye_height, directions, sun)
        behind, sunlight, around = above.radiance, choice.sun_intensity * above.sunlight, above.ambient
    azimuth = radians_from_degrees(choice.camera_azimuth)
    backdrop = build_plain(directions, choice.eye_height, azimuth, sun, sunlight, medium, behind, around)
    light = choice.light(sun, sunlight, backdrop.ambient)
    return put_fog(backdrop, medium, choice.eye_height, directions, light).reduced(SUPERSAMPLING)


def fog_over_photograph(choice: FogChoice, factor: float, image: Path, depth: Path, kind: DepthKind) -> "FoggyPicture":
    """A picture with its depth through fog of a multiple of the visibility.

    Raises:
        ParameterError, CameraError: numbers without meaning, or two sizes.
        PhotographError: a file cannot be read.
    """
    from cloudfit.fog_picture import photograph_backdrop, put_fog
    from render.depth_files import read_depth
    from render.image_files import read_image

    radiance, distance = read_image(image).pixels, read_depth(depth).double()
    medium, (sun, sunlight) = choice.build_medium(factor), choice.sun()
    directions = choice.directions(radiance.shape[1], radiance.shape[0])
    if kind is DepthKind.Z and distance.shape == directions.shape[:2]:
        forward = choice.directions(1, 1)[0, 0]
        distance = distance / (directions @ forward)
    backdrop = photograph_backdrop(radiance, distance, str(depth))
    return put_fog(backdrop, medium, choice.eye_height, directions, choice.light(sun, sunlight, backdrop.ambient))


def write_pictures(files: list[Path], pictures: "list[FoggyPicture]", exposure: float) -> None:
    """Write the pictures side by side to every file; the exposure brightens the light in all of them."""
    import torch

    gain = 2.0**exposure
    layers = [picture.layers() for picture in pictures]
    joined = {name: torch.cat([layer[name] for layer in layers], dim=1) for name in layers[0]}
    for name in ("rgb", "scattered"):
        joined[name] = gain * joined[name]
    for path in files:
        _WRITERS[path.suffix.lower()](path, joined)


def _write_png(path: Path, layers: "dict[str, Tensor]") -> None:
    from render.image_files import write_png

    write_png(path, layers["rgb"].float())


def _write_exr(path: Path, layers: "dict[str, Tensor]") -> None:
    from render.image_files import write_exr

    write_exr(path, layers)


_WRITERS = {".png": _write_png, ".exr": _write_exr}


def tell_fog(
    choice: FogChoice, factors: tuple[float, ...], files: list[Path], seconds: float, speaker: Speaker, as_json: bool
) -> None:
    """Say what fog that was, and print the files or JSON."""
    import torch

    from cloudfit.fog_picture import depth_to_sun
    from render.media import compute_optical_depth

    fogs: list[dict[str, Any]] = []
    for factor in factors:
        medium = choice.build_medium(factor)
        ground = torch.tensor(0.0, dtype=torch.float64)
        upwards = compute_optical_depth(medium, ground, 1.0).item()
        direct = torch.exp(-depth_to_sun(medium, ground, choice.sun()[0])).item()
        fogs.append(
            {
                "visibility_m": _finite(factor * choice.visibility),
                "vertical_optical_depth": upwards,
                "direct_sunlight": direct,
            }
        )
        speaker.say(
            f"{choice.medium} fog, visibility {factor * choice.visibility:g} m: optical depth {upwards:.3g} straight up, "
            f"{direct:.1%} of the sunlight comes through"
        )
    speaker.say(f"rendered in {seconds:.1f} s")
    if as_json:
        document = {
            "schema": "cloudfit fog 1",
            "files": [str(path) for path in files],
            "medium": choice.medium,
            "fogs": fogs,
        }
        print_json({**document, "seconds": seconds})
    else:
        for path in files:
            print(path)


def _finite(value: float) -> float | None:
    return None if value == float("inf") else value
