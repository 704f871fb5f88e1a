"""`cloudfit shafts`: shafts of light through air and fog."""

import enum
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cloudfit.commands import options as o
from cloudfit.commands.console import Speaker, print_json, reported_errors
from render.units import radians_from_degrees

if TYPE_CHECKING:
    from torch import Tensor

    from render.shafts.frame import Frame
    from render.shafts.methods import Method
    from render.shafts.scene import ShaftScene

EPILOG = """Examples:

cloudfit shafts ridge --out ridge.png

cloudfit shafts window --method brute_force --camera-width 1920 --camera-height 1080 --out window.png --out window.exr

cloudfit shafts columns --sheet-times 6,8,12,18 --out day.png

cloudfit shafts lamps_in_fog --sheet-seconds 0,10,20,30 --out "drift_{}.png"

cloudfit shafts my_scene.toml --tolerance 0.01 --out mine.png

The presets are columns, fogbank, lamps_in_fog, lights, ridge and window.
docs/shafts.md has the keys of scene files and the errors of the methods.

Exit codes: 0 all done, 2 wrong usage, 3 bad input, 130 interrupted."""

SHADOWS, PICTURE = "Shadows", "Picture"


class MethodName(enum.StrEnum):
    """Methods; the same names as in `render.shafts.methods.METHODS`."""

    AUTO = "auto"
    BRUTE_FORCE = "brute_force"
    ENGELHARDT2010 = "engelhardt2010"
    CHEN2011 = "chen2011"
    ALI2017 = "ali2017"
    INTERLEAVED = "interleaved"
    BIRI2006 = "biri2006"
    WYMAN2013 = "wyman2013"
    ADAPTIVE = "adaptive"
    TAN2020_FROXELS = "tan2020_froxels"


Scene = Annotated[str, typer.Argument(help="A preset or a scene file (.toml).")]
MethodChoice = Annotated[MethodName, typer.Option("--method", help="How the light is gathered.", rich_help_panel=o.RUN)]
Tolerance = Annotated[
    float | None,
    typer.Option(
        min=1e-4, help="Accepted relative error of the scattered light; picks the settings.", rich_help_panel=o.RUN
    ),
]
Size = Annotated[int | None, typer.Option(min=1, help="Instead of that of the scene.", rich_help_panel=o.CAMERA)]
SunElevation = Annotated[
    float | None,
    typer.Option(min=-90, max=90, help="In degrees, instead of that of the scene.", rich_help_panel=o.SCENE),
]
SunAzimuth = Annotated[
    float | None, typer.Option(help="In degrees, instead of that of the scene.", rich_help_panel=o.SCENE)
]
SheetTimes = Annotated[
    str | None,
    typer.Option(help="Hours of the day, such as 6,9,12: a picture for each, side by side.", rich_help_panel=PICTURE),
]
SheetSeconds = Annotated[
    str | None,
    typer.Option(help="Times of the fog in seconds, such as 0,20,40: as --sheet-times.", rich_help_panel=PICTURE),
]
FogStrength = Annotated[
    float, typer.Option(min=0, help="Factor on the density of all banks of fog.", rich_help_panel=o.SCENE)
]
Latitude = Annotated[
    float, typer.Option(min=-90, max=90, help="In degrees, for --sheet-times.", rich_help_panel=PICTURE)
]
Day = Annotated[int, typer.Option(min=1, max=366, help="Of the year, for --sheet-times.", rich_help_panel=PICTURE)]
Exposure = Annotated[float, typer.Option(help="Stops by which the picture is brightened.", rich_help_panel=PICTURE)]
Out = Annotated[
    list[Path] | None,
    typer.Option(
        help="File to write, .png or .exr; repeat it for both. A {} in the name becomes the number of each picture of a sheet, "
        "which then has a file of its own.",
        show_default="shafts.png",
        rich_help_panel=PICTURE,
    ),
]
NoAir = Annotated[bool, typer.Option("--off-on", help="The scene without air beside it.", rich_help_panel=PICTURE)]
SunMap = Annotated[int, typer.Option(min=1, help="Texels of the sun's shadow map.", rich_help_panel=SHADOWS)]
LampMap = Annotated[
    int, typer.Option(min=1, help="Texels along an edge of a lamp's cube map.", rich_help_panel=SHADOWS)
]
Exact = Annotated[bool, typer.Option("--exact-shadows", help="A ray for every look; slow.", rich_help_panel=SHADOWS)]


def shafts(
    scene: Scene = "ridge",
    out: Out = None,
    method: MethodChoice = MethodName.AUTO,
    tolerance: Tolerance = None,
    sun_azimuth: SunAzimuth = None,
    sun_elevation: SunElevation = None,
    camera_width: Size = None,
    camera_height: Size = None,
    sheet_times: SheetTimes = None,
    sheet_seconds: SheetSeconds = None,
    fog_strength: FogStrength = 1.0,
    latitude: Latitude = 47.0,
    day: Day = 172,
    off_on: NoAir = False,
    sun_map: SunMap = 2048,
    lamp_map: LampMap = 256,
    exact_shadows: Exact = False,
    exposure: Exposure = 0.0,
    quiet: o.Quiet = False,
    json: o.AsJson = False,
) -> None:
    """See shafts of light through air and fog: god rays over a ridge, a window, columns, lamps at night, or your scene.

    Light is scattered once; what is scattered more often is taken to come from everywhere (docs/shafts.md).
    """
    speaker = Speaker(quiet)
    files = out or [Path("shafts.png")]
    with reported_errors(speaker):
        from cloudfit.batch import available_cores, limit_threads
        from render.shafts.frame import render_frame
        from render.shafts.methods import find_method
        from render.shafts.scene_file import load_scene
        from render.shafts.stage import MapSettings

        check_files(files)
        limit_threads(available_cores())
        started = time.perf_counter()
        maps = MapSettings(sun_map, lamp_map, exact_shadows)
        whole = resized(load_scene(scene), camera_width, camera_height)
        foggy = list_fogs(whole, sheet_seconds, fog_strength)
        sun = (sun_azimuth, sun_elevation)
        scenes = [scene for one in foggy for scene in list_scenes(one, sun, sheet_times, latitude, day)]
        frames = []
        with speaker.progress() as bars:
            for number, one in enumerate(scenes):
                bars.stage("shafts", number / len(scenes))
                chosen = choose_method(find_method(method.value), one, tolerance, maps, speaker)
                frames.append(render_frame(one, chosen, maps))
        files = write_frames(files, frames, exposure, off_on)
        tell_frames(frames, files, time.perf_counter() - started, speaker, json)


def check_files(files: list[Path]) -> None:
    """Raise ParameterError for names of other kinds."""
    from render.errors import ParameterError

    for path in files:
        if path.suffix.lower() not in _WRITERS:
            raise ParameterError(f"{path}: expected a name that ends in {' or '.join(_WRITERS)}")


def resized(scene: "ShaftScene", width: int | None, height: int | None) -> "ShaftScene":
    """The scene with the pixel counts that are given; one alone keeps the proportions."""
    camera = scene.camera
    if width is None and height is None:
        return scene
    if width is None:
        width = max(1, round(camera.width * (height or 1) / camera.height))
    if height is None:
        height = max(1, round(camera.height * width / camera.width))
    return scene.resized(width, height)


def list_scenes(
    scene: "ShaftScene", sun: tuple[float | None, float | None], times: str | None, latitude: float, day: int
) -> "list[ShaftScene]":
    """The scene under the sun that is asked for: its own, one from angles in degrees, or one for each hour.

    Raises:
        ParameterError: for hours that are none, or a sun for a scene that has none.
    """
    from dataclasses import replace

    from cloudfit.sun_path import find_sun
    from render.camera import direction_from_angles
    from render.errors import ParameterError
    from render.shafts.scene_file import make_sun

    if times is None and sun == (None, None):
        return [scene]
    if scene.sun is None:
        raise ParameterError("the scene has no sun that could be moved")
    if times is not None:
        angles = [find_sun(hour, radians_from_degrees(latitude), day) for hour in parse_hours(times)]
        intensity = max(scene.sun.irradiance) / max(make_sun(0.0, radians_from_degrees(30.0)).irradiance)
        suns = [make_sun(*pair, intensity) for pair in angles]
        return [
            replace(scene, sun=replace(scene.sun, direction=sun.direction, irradiance=sun.irradiance)) for sun in suns
        ]
    if sun[0] is None or sun[1] is None:
        raise ParameterError("--sun-azimuth and --sun-elevation go together")
    direction = direction_from_angles(radians_from_degrees(sun[0]), radians_from_degrees(sun[1]))
    return [replace(scene, sun=replace(scene.sun, direction=direction))]


def list_fogs(scene: "ShaftScene", seconds: str | None, strength: float) -> "list[ShaftScene]":
    """The scene with its banks of fog of a strength, at each of the times that are asked for, or at its own.

    Raises:
        ParameterError: for times that are none, or anything asked of a scene without banks.
    """
    from dataclasses import replace

    from render.errors import ParameterError

    if seconds is None and strength == 1.0:
        return [scene]
    if not scene.air.banks:
        raise ParameterError("the scene has no bank of fog that could be changed")
    banks = tuple(replace(bank, strength=strength * bank.strength) for bank in scene.air.banks)
    scene = replace(scene, air=replace(scene.air, banks=banks))
    return [scene] if seconds is None else [scene.at_time(time) for time in parse_numbers(seconds, "seconds", math.inf)]


def parse_hours(text: str) -> list[float]:
    """Hours from a text such as 6,7.5,12. Raises ParameterError for anything else."""
    return parse_numbers(text, "hours of the day", 24.0)


def parse_numbers(text: str, name: str, most: float) -> list[float]:
    """Finite numbers from 0 to a limit from a text such as 6,7.5,12. Raises ParameterError for anything else."""
    from render.errors import ParameterError

    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not numbers or not all(0.0 <= number <= most and math.isfinite(number) for number in numbers):
        raise ParameterError(f"expected {name} such as 6,7.5,12, got {text!r}")
    return numbers


def choose_method(
    method: "Method", scene: "ShaftScene", tolerance: float | None, maps: Any, speaker: Speaker
) -> "Method":
    """The method, refined for the tolerance if there is one."""
    from render.shafts.truth import choose_settings

    if tolerance is None:
        return method
    chosen = choose_settings(scene, method, tolerance, maps)
    speaker.say(
        f"settings refined {chosen.refinements} times: error {chosen.error.relative_rms:.2%} on a coarse picture, "
        f"{tolerance:.2%} accepted"
    )
    return chosen.method


def write_frames(files: list[Path], frames: "list[Frame]", exposure: float, off_on: bool) -> list[Path]:
    """Write the frames to every file: side by side, or a file for each where a name has a place for its number.

    Args:
        files: names.
        frames: one or more.
        exposure: stops by which they are brightened.
        off_on: put what is seen without air on the left of each.

    Returns:
        The files that were written.
    """
    written = []
    for path in files:
        numbered = "{}" in path.name
        for number in range(len(frames) if numbered else 1):
            some = frames[number : number + 1] if numbered else frames
            name = path.with_name(path.name.replace("{}", f"{number:03}"))
            _WRITERS[path.suffix.lower()](name, _join_frames(some, exposure, off_on))
            written.append(name)
    return written


def _join_frames(frames: "list[Frame]", exposure: float, off_on: bool) -> "dict[str, Tensor]":
    """Layers of frames side by side."""
    import torch

    gain = 2.0**exposure
    layers = [frame.layers() for frame in frames]
    joined = {name: torch.cat([layer[name] for layer in layers], dim=1) for name in layers[0]}
    if off_on:
        parts = [part for frame in frames for part in (frame.background, frame.radiance)]
        joined = {"rgb": torch.cat(parts, dim=1)}
    for name in set(joined) - {"transmittance", "distance"}:
        joined[name] = gain * joined[name]
    return joined


def _write_png(path: Path, layers: "dict[str, Tensor]") -> None:
    from render.image_files import write_png

    # Bright shafts fade into white instead of ending in it: below 0.6 nothing changes.
    light = layers["rgb"].float()
    bright = (light - 0.6).clamp(min=0.0)
    write_png(path, light.clamp(max=0.6) + bright / (1.0 + 2.5 * bright))


def _write_exr(path: Path, layers: "dict[str, Tensor]") -> None:
    from render.image_files import write_exr

    write_exr(path, layers)


_WRITERS = {".png": _write_png, ".exr": _write_exr}


def tell_frames(frames: "list[Frame]", files: list[Path], seconds: float, speaker: Speaker, as_json: bool) -> None:
    """Say what was modelled and skipped, and print the files or JSON."""
    for sentence in dict.fromkeys(s for frame in frames for s in frame.modelled):
        speaker.say(f"modelled: {sentence}")
    for sentence in dict.fromkeys(s for frame in frames for s in frame.skipped):
        speaker.say(f"skipped: {sentence}")
    speaker.say(f"rendered in {seconds:.1f} s")
    if not as_json:
        for path in files:
            print(path)
        return
    described = [
        {
            "modelled": frame.modelled,
            "skipped": frame.skipped,
            "seconds": {k.strip(): v for k, v in frame.seconds.items()},
        }
        for frame in frames
    ]
    print_json(
        {"schema": "cloudfit shafts 1", "files": [str(path) for path in files], "frames": described, "seconds": seconds}
    )
