"""Scenes as TOML files, in metres and degrees; docs/shafts.md lists the keys."""

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from render.camera import PinholeCamera, direction_from_angles
from render.errors import CameraError, ParameterError, SceneError
from render.gradient_sky import sunlight_through_air
from render.media import ExponentialDecay, LayeredMedium, LinearDecay, Uniform, extinction_from_visibility
from render.shafts.air import Air, Constituent
from render.shafts.casters import (
    GRASS,
    ROCK,
    STONE,
    make_box,
    make_columns,
    make_ground,
    make_ridge,
    make_sphere,
    make_window,
)
from render.shafts.fog_bank import FogBank
from render.shafts.lights import SUN_RADIUS, PointLight, Sun
from render.shafts.mesh import GREY, Mesh, place_mesh, read_obj
from render.shafts.participating_media import SpheroidMedium
from render.shafts.particles import Colour
from render.shafts.scene import ShaftScene
from render.shafts.strict_table import StrictTable
from render.units import degrees_from_radians, radians_from_degrees

PRESET_FOLDER = Path(__file__).parent / "presets"

PRESETS = tuple(sorted(path.stem for path in PRESET_FOLDER.glob("*.toml")))
"""Names of the scenes that come with the package."""


def load_scene(name: str | Path) -> ShaftScene:
    """The preset of that name, or else the scene of that file.

    Raises:
        SceneError: there is no such file, it is no TOML, or it holds a key or a value that is none.
        MissingExtraError: it names a mesh file, and trimesh is not installed.
    """
    path = Path(name)
    if str(name) in PRESETS:
        path = PRESET_FOLDER / f"{name}.toml"
    if not path.is_file():
        raise SceneError(f"{name}: no such scene file, and no preset; there are the presets {', '.join(PRESETS)}")
    try:
        return parse_scene(path.read_text(encoding="utf-8"), str(name), path.parent)
    except UnicodeDecodeError:
        raise SceneError(f"{name}: not a text file in UTF-8") from None


def parse_scene(text: str, name: str, folder: Path) -> ShaftScene:
    """The scene that a TOML text states.

    Args:
        text: the TOML.
        name: of the file, for messages.
        folder: where mesh files are looked for.

    Returns:
        The scene.

    Raises:
        SceneError: it is no TOML, or holds a key or a value that is none.
        MissingExtraError: it names a mesh file, and trimesh is not installed.
    """
    try:
        root = StrictTable(tomllib.loads(text), name)
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{name}: not a TOML file ({error})") from None
    try:
        return _read_scene(root, folder)
    except (ParameterError, CameraError) as error:
        raise SceneError(f"{name}: {error}") from error


def make_sun(azimuth: float, elevation: float, intensity: float = 1.0, colour: Colour | None = None) -> Sun:
    """The sun at a place in the sky, reddened by clear air unless a colour is given.

    Args:
        azimuth: [rad, clockwise from north].
        elevation: [rad].
        intensity: radiance of a white surface that faces the sun, before the colour [1].
        colour: red, green and blue [1]; None for what clear air lets through.

    Returns:
        The sun.
    """
    red, green, blue = sunlight_through_air(elevation) if colour is None else colour
    scale = math.pi * intensity
    return Sun(direction_from_angles(azimuth, elevation), (scale * red, scale * green, scale * blue))


def _read_scene(root: StrictTable, folder: Path) -> ShaftScene:
    meshes = [mesh for kind, read in _THINGS.items() for table in root.tables(kind) for mesh in [read(table, folder)]]
    time = root.number("time_s", 0.0)
    scene = ShaftScene(
        camera=_read_camera(root.table("camera")),
        meshes=tuple(meshes),
        air=Air(
            tuple(_read_constituent(table) for table in root.tables("air")),
            tuple(_read_bank(table, time) for table in root.tables("bank")),
        ),
        sun=_read_sun(root.table("sun")) if root.has("sun") else None,
        lights=tuple(_read_light(table) for table in root.tables("light")),
        ambient=root.triple("ambient", (0.0, 0.0, 0.0)),
        sky=root.triple("sky") if root.has("sky") else None,
        reach=root.number("reach_m", 1000.0),
    )
    root.finish()
    return scene


def _read_camera(table: StrictTable) -> PinholeCamera:
    camera = PinholeCamera(
        position=table.triple("position_m"),
        target=table.triple("target_m"),
        field_of_view=radians_from_degrees(table.number("fov_deg", 50.0)),
        width=table.whole("width", 960),
        height=table.whole("height", 540),
    )
    table.finish()
    return camera


def _read_sun(table: StrictTable) -> Sun:
    sun = make_sun(
        radians_from_degrees(table.number("azimuth_deg")),
        radians_from_degrees(table.number("elevation_deg")),
        table.number("intensity", 1.0),
        table.triple("colour") if table.has("colour") else None,
    )
    radius = radians_from_degrees(table.number("radius_deg", degrees_from_radians(SUN_RADIUS)))
    sun = replace(sun, angular_radius=radius, shadow_points=table.whole("shadow_points", 1))
    table.finish()
    return sun


def _read_light(table: StrictTable) -> PointLight:
    light = PointLight(
        position=table.triple("position_m"),
        intensity=table.triple("intensity"),
        radius=table.number("radius_m", 0.05),
        reach=table.number("reach_m", math.inf),
        shadow_points=table.whole("shadow_points", 1),
    )
    table.finish()
    return light


def _read_constituent(table: StrictTable) -> Constituent:
    profile = table.word("profile", "uniform")
    if profile not in _PROFILES:
        raise SceneError(f"{table.place}: no profile is called {profile!r}; there are {', '.join(_PROFILES)}")
    part = Constituent(
        medium=_PROFILES[profile](_read_extinction(table), table),
        colour=table.triple("colour", (1.0, 1.0, 1.0)),
        albedo=table.number("albedo", 1.0),
        phase=table.word("phase", "henyey_greenstein"),
        asymmetry=table.number("asymmetry", 0.0),
    )
    table.finish()
    return part


def _read_extinction(table: StrictTable) -> float:
    if table.has("visibility_m") == table.has("extinction_per_m"):
        raise SceneError(f"{table.place}: give either visibility_m or extinction_per_m")
    if table.has("visibility_m"):
        return extinction_from_visibility(table.number("visibility_m"))
    return table.number("extinction_per_m")


def _read_bank(table: StrictTable, time: float) -> FogBank:
    """Spheroids around a middle; the extinction is that of their densest places."""
    medium = SpheroidMedium(
        middle=table.triple("middle_m"),
        spread=table.triple("spread_m"),
        count=table.whole("count"),
        radius=table.number("radius_m"),
        radius_variation=table.number("radius_variation", 0.3),
        flattening=table.number("flattening", 0.6),
        noise_amplitude=table.number("noise_amplitude", 0.4),
        noise_wavelength=table.number("noise_wavelength_m", table.number("radius_m")),
        scale_height=table.number("scale_height_m", math.inf),
        base=table.number("base_m", -math.inf),
        extent=table.number("extent_m", math.inf),
        wind=table.triple("wind_m_per_s", (0.0, 0.0, 0.0)),
        change_time=table.number("change_time_s", math.inf),
        seed=table.whole("seed", 0),
    )
    bank = FogBank(
        medium,
        extinction=_read_extinction(table),
        colour=table.triple("colour", (1.0, 1.0, 1.0)),
        albedo=table.number("albedo", 1.0),
        phase=table.word("phase", "henyey_greenstein"),
        asymmetry=table.number("asymmetry", 0.0),
        strength=table.number("strength", 1.0),
        time=time,
        resolution=table.whole("resolution", 64),
        shadow=table.truth("shadow", True),
    )
    table.finish()
    return bank


_PROFILES: Mapping[str, Callable[[float, StrictTable], LayeredMedium]] = MappingProxyType(
    {
        "uniform": lambda sigma, table: Uniform(sigma, table.number("top_m"), table.number("base_m", -math.inf)),
        "linear": lambda sigma, table: LinearDecay(sigma, table.number("top_m"), table.number("base_m", 0.0)),
        "exponential": lambda sigma, table: ExponentialDecay(
            sigma, table.number("scale_height_m"), table.number("base_m", -math.inf), table.number("reference_m", 0.0)
        ),
    }
)
"""Each reads what it needs besides the extinction."""


def _placed(mesh: Mesh, table: StrictTable) -> Mesh:
    turn = radians_from_degrees(table.number("turn_deg", 0.0))
    placed = place_mesh(mesh, scale=table.number("scale", 1.0), turn=turn, offset=table.triple("offset_m", (0, 0, 0)))
    table.finish()
    return placed


def _read_mesh(table: StrictTable, folder: Path) -> Mesh:
    path = folder / table.word("file")
    return _placed(read_obj(path, table.triple("albedo", GREY), table.truth("y_up", True)), table)


def _read_sphere(table: StrictTable, _: Path) -> Mesh:
    sphere = make_sphere(
        table.triple("centre_m"), table.number("radius_m"), table.whole("rings", 64), table.triple("albedo", GREY)
    )
    table.finish()
    return sphere


def _read_box(table: StrictTable, _: Path) -> Mesh:
    return _placed(make_box(table.triple("lower_m"), table.triple("upper_m"), table.triple("albedo", GREY)), table)


def _read_columns(table: StrictTable, _: Path) -> Mesh:
    columns = make_columns(
        table.whole("count", 5),
        table.number("spacing_m"),
        table.number("radius_m"),
        table.number("height_m"),
        table.triple("albedo", STONE),
    )
    return _placed(columns, table)


def _read_window(table: StrictTable, _: Path) -> Mesh:
    window = make_window(
        table.number("width_m"),
        table.number("height_m"),
        (table.whole("panes_across", 2), table.whole("panes_up", 3)),
        table.number("bar_m"),
        table.triple("wall_m"),
        table.number("thickness_m"),
        table.triple("albedo", STONE),
    )
    return _placed(window, table)


def _read_ridge(table: StrictTable, _: Path) -> Mesh:
    ridge = make_ridge(
        table.number("length_m"),
        table.number("width_m"),
        table.number("height_m"),
        table.whole("samples", 256),
        table.whole("peaks", 5),
        table.whole("seed", 3),
        table.triple("albedo", ROCK),
    )
    return _placed(ridge, table)


def _read_ground(table: StrictTable, _: Path) -> Mesh:
    ground = make_ground(table.number("half_width_m"), table.number("height_m", 0.0), table.triple("albedo", GRASS))
    table.finish()
    return ground


_THINGS: Mapping[str, Callable[[StrictTable, Path], Mesh]] = MappingProxyType(
    {
        "mesh": _read_mesh,
        "sphere": _read_sphere,
        "box": _read_box,
        "columns": _read_columns,
        "window": _read_window,
        "ridge": _read_ridge,
        "ground": _read_ground,
    }
)
"""What may stand in a scene: a table each."""
