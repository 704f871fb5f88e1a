"""What does each knob of the stack buy?

Around a preset one knob at a time is set to other values: accepted error, paths, source points, orders, nodes, strata, marching step,
smoothing, storage, bins of the histograms, resolution. At random parameter sets (asymmetry 0 to 0.9, largest optical depth 0.05 to 60,
albedo 0.8 to 1) the stack's images are compared with reference images: a stack for each set with that one node and much more effort.
How far these are from the path tracer is measured too.
"""

import argparse
import tempfile
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.table import Table

from benchmarks.common import (
    ROOT,
    Outcome,
    add_output_argument,
    add_volume_argument,
    available_cores,
    make_table,
    scene_of,
    set_threads,
    show,
    spread,
    stopwatch,
    tell_progress,
)
from benchmarks.front import Point, draw_front, pareto_front
from benchmarks.parameter_sets import draw_sets, table_nodes, varied
from benchmarks.reference_stack import Difference, ReferenceImages
from benchmarks.stack_settings import KNOBS, Recipe, Setting, preset_setting
from benchmarks.tradeoff_fits import FitLoss, FitPhotographs, fit_table
from cloudfit.quality import QUALITIES, Quality
from cloudfit.scene import Scene
from precompute.error_budget import Effort
from precompute.scattering_orders import build_scattering_stack
from precompute.stack_store import round_tables
from render.scattering_stack import ScatteringStack, ScatteringTables

WIDTH, HEIGHT = 320, 240

QUICK_SIZE = (48, 36)

QUICK_EFFORT = Effort(10, 1_000, 10_000, 4, True, 0.2)

QUICK_QUALITY = Quality(1.0, QUICK_EFFORT, QUICK_EFFORT, 4, 0.7, 10.0)

QUICK_KNOBS = ["orders", "smoothing", "storage", "bins", "resolution"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    add_volume_argument(parser)
    parser.add_argument(
        "--quality", choices=QUALITIES, default="standard", help="the preset around which knobs are turned"
    )
    parser.add_argument("--knobs", nargs="+", choices=KNOBS, default=list(KNOBS))
    parser.add_argument("--sets", type=int, default=12, help="random parameter sets")
    parser.add_argument("--repeats", type=int, default=2, help="stacks of each setting, with other seeds")
    parser.add_argument("--pixels", type=int, default=400, help="that the path tracer traces")
    parser.add_argument("--traced", type=int, default=2_000_000, help="paths of each path-traced reference; 0 for none")
    parser.add_argument("--fits", type=int, default=0, metavar="N", help="photographs to fit with each setting")
    parser.add_argument("--photographs", type=Path, help="folder of those; without it they are synthetic")
    parser.add_argument("--threads", type=int, default=available_cores())
    add_output_argument(
        parser, "folder of the plot; references are kept in its folder cache (default: benchmarks/results)"
    )


@dataclass(frozen=True)
class Build:
    """One stack of a setting.

    Args:
        seconds: to build the tables.
        paths: traced.
        stated: median over the nodes of the error that the stack states.
        candidate_ms: to compose a candidate and count its histogram.
        differences: from the reference images, one a parameter set.
    """

    seconds: float
    paths: int
    stated: float
    candidate_ms: float
    differences: tuple[Difference, ...]


@dataclass(frozen=True)
class Measured:
    """A setting with its builds, and its fits if there were any."""

    setting: Setting
    builds: list[Build]
    fits: list[FitLoss]

    def summary(self, name: str) -> dict[str, float]:
        """Median and quartiles over builds and parameter sets of a number of the `Difference`."""
        return spread(getattr(one, name) for build in self.builds for one in build.differences)

    @property
    def seconds(self) -> dict[str, float]:
        """Median and quartiles."""
        return spread(build.seconds for build in self.builds)


def run(arguments: argparse.Namespace) -> Outcome:
    """Build, compare, draw."""
    if arguments.quick:
        arguments.sets, arguments.repeats, arguments.knobs = 2, 1, QUICK_KNOBS
        arguments.pixels, arguments.traced = 20, 2_000
    set_threads(arguments.threads)
    no_folder = arguments.quick and arguments.out is None
    folder = arguments.out or ROOT / "benchmarks" / "results"
    with tempfile.TemporaryDirectory() if no_folder else nullcontext(folder) as out:
        return _run(arguments, Path(out))


def _run(arguments: argparse.Namespace, out: Path) -> Outcome:
    size = QUICK_SIZE if arguments.quick else (WIDTH, HEIGHT)
    scene, volume = scene_of(arguments, *size)
    base = preset_setting(QUICK_QUALITY if arguments.quick else QUALITIES[arguments.quality], *size)
    settings = [base, *(setting for knob in arguments.knobs for setting in KNOBS[knob](base))]
    effort = QUICK_EFFORT if arguments.quick else QUALITIES["reference"].picture_effort
    references = ReferenceImages(scene, draw_sets(arguments.sets), effort, out / "cache")
    with stopwatch() as seconds:
        references.build()
    tell_progress(f"{arguments.sets} reference images: {seconds[0]:.0f} s")
    truth = references.trace(arguments.pixels, arguments.traced) if arguments.traced else []
    judge = QUICK_EFFORT if arguments.quick else QUALITIES["standard"].picture_effort
    photographs = FitPhotographs.prepare(arguments, scene, judge, out / "cache")
    _warm_up(scene)
    measured = _measure_all(settings, scene, references, photographs, arguments.repeats)
    drawn = _first_of_each_recipe(measured)
    points = [_point(measured[number]) for number in drawn]
    title = f"{volume}: {base.recipe.width} x {base.recipe.height} tables, {arguments.threads} threads"
    files = draw_front(
        points,
        title,
        "relative RMS error of the image, per cent (upper quartile of the parameter sets)",
        out,
        "tradeoff",
    )
    tell_progress(f"plot: {files[0]}")
    front = {drawn[number] for number in pareto_front(points)}
    names = ("quality", "knobs", "sets", "repeats", "pixels", "traced", "fits", "threads")
    values = {
        "volume": volume,
        "size": size,
        "settings": {name: getattr(arguments, name) for name in names},
        "reference_seconds": seconds[0],
        "reference_against_path_tracer": [asdict(one) for one in truth],
        "measured": [_as_json(one, number in front) for number, one in enumerate(measured)],
    }
    notes = [*NOTES, *references.describe(truth), *photographs.notes]
    tables = [_table(title, measured, front)]
    if photographs.analyses:
        tables.append(fit_table([(one.setting, one.fits) for one in measured if one.fits]))
    return Outcome(values, tuple(tables), tuple(notes))


NOTES = (
    "one knob differs from the preset in each row; the number of paths is chosen by the tolerance unless the row says just",
    "error: relative RMS over the pixels of the grey image; grey levels: Wasserstein distance of the histograms of a picture that the "
    "light makes as bright as a photograph's cloud; L1 / floor: L1 distance of the same over that of two unrelated samples",
    "a table of lower resolution is compared with the reference averaged over its larger pixels, which has a blur of its own",
    "bins change nothing but the histograms, storage nothing but the rounding: these rows have the preset's seconds and are not drawn",
    "*: no other setting is both faster and more accurate",
)


def _warm_up(scene: Scene) -> None:
    """Have the fused loops compiled before anything is timed."""
    quality = Quality(1.0, QUICK_EFFORT, QUICK_EFFORT, 2, 2.0, 10.0)
    _build(scene, Recipe(quality, *QUICK_SIZE), 0)


def _build(scene: Scene, recipe: Recipe, seed: int) -> ScatteringTables:
    camera = scene.camera.resized(recipe.width, recipe.height)
    largest = ReferenceImages.largest_optical_length(scene)
    with varied(recipe.constants):
        return build_scattering_stack(
            scene.grid,
            camera,
            scene.sun_direction,
            *table_nodes(recipe.quality, largest),
            recipe.quality.table_effort,
            seed,
        )


def _measure_all(
    settings: list[Setting], scene: Scene, references: ReferenceImages, photographs: FitPhotographs, repeats: int
) -> list[Measured]:
    """Build every recipe once for each seed, and read it out in all settings that share it."""
    found = {id(setting): Measured(setting, [], []) for setting in settings}
    for recipe in dict.fromkeys(setting.recipe for setting in settings):
        readers = [setting for setting in settings if setting.recipe == recipe]
        for seed in range(repeats):
            with stopwatch() as seconds:
                tables = _build(scene, recipe, seed)
            for setting in readers:
                stack = ScatteringStack(
                    round_tables(tables) if setting.rounded else tables, recipe.quality.largest_image_error
                )
                one = found[id(setting)]
                one.builds.append(_read(stack, setting, references, seconds[0]))
                if seed == 0:
                    one.fits.extend(photographs.fit(stack, setting))
        for setting in readers:
            error = show(found[id(setting)].summary("error"))
            tell_progress(f"{setting.knob} {setting.value}: {seconds[0]:.1f} s, error {error}")
    return list(found.values())


def _read(stack: ScatteringStack, setting: Setting, references: ReferenceImages, seconds: float) -> Build:
    differences, candidate_ms = references.compare(stack, setting.bins)
    tables = stack.tables
    paths = sum(int(str(group["paths"])) for group in tables.groups)
    return Build(seconds, paths, float(tables.image_error.median()), candidate_ms, tuple(differences))


def _first_of_each_recipe(measured: list[Measured]) -> list[int]:
    """Numbers of the settings to draw: those that share a recipe would lie on one another."""
    recipes = [one.setting.recipe for one in measured]
    return [number for number, recipe in enumerate(recipes) if recipes.index(recipe) == number]


def _point(one: Measured) -> Point:
    name = one.setting.knob if one.setting.knob == "preset" else f"{one.setting.knob}: {one.setting.value}"
    error = 100.0 * one.summary("error")["upper_quartile"]
    return Point(one.setting.knob, name, one.seconds["median"], max(error, 1e-7))


def _as_json(one: Measured, on_front: bool) -> dict[str, object]:
    setting = one.setting
    return {
        "knob": setting.knob,
        "value": setting.value,
        "on_front": on_front,
        "seconds": one.seconds,
        "error": one.summary("error"),
        "grey_levels": one.summary("grey_levels"),
        "l1_over_floor": one.summary("l1_over_floor"),
        "effort": asdict(setting.effort),
        "builds": [asdict(build) for build in one.builds],
        "fits": [asdict(fit) for fit in one.fits],
    }


def _table(title: str, measured: list[Measured], front: set[int]) -> Table:
    columns = (
        "knob",
        "value",
        "seconds",
        "M paths",
        "error",
        "largest",
        "stated",
        "grey levels",
        "L1 / floor",
        "ms",
        "",
    )
    rows = []
    for number, one in enumerate(measured):
        error = one.summary("error")
        rows.append(
            (
                one.setting.knob,
                one.setting.value,
                one.seconds["median"],
                spread(build.paths / 1e6 for build in one.builds)["median"],
                f"{error['median']:.2%}",
                f"{error['largest']:.1%}",
                f"{spread(build.stated for build in one.builds)['median']:.2%}",
                show(one.summary("grey_levels"), 2),
                show(one.summary("l1_over_floor"), 2),
                spread(build.candidate_ms for build in one.builds)["median"],
                "*" if number in front else "",
            )
        )
    return make_table(title, columns, rows)
