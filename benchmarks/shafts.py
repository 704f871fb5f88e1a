"""What does each way of marching shafts of light cost in time, at which error?

Three scenes that `cloudfit shafts` shows (a ridge, a window, lamps at night), each made ready once: depth buffer and shadow maps are the
same for all methods, and only the part `stages` counts them. A method's seconds are those of its in-scattered light, its errors those
against the truth: a march along every pixel's ray whose steps are doubled until they change the light by less than 0.1 %, with the
same maps. Where that would take minutes, the truth is marched in 64 tiles at random places, unless `--whole-truth`. Methods take turns.
`--parts` chooses among:

- `methods`: each with its usual settings and refined, a drawing of time and error with `--out`
- `stages`: what the parts of a frame take (as table 1 of Tan et al. 2020)
- `resolutions`: frames per second at three sizes (their table 2)
- `equal_time`: steps that each method affords in one time, and the error that they leave (their table 3)
- `filter`: 200 steps against 60 and a filter (figure 9 of Ali et al. 2017)
- `taps`: of the filter
- `triangles`: 1 k to 1 M (their table 1)
- `lamps`: 1 to 32, with the line that fits
- `tolerance`: does `--tolerance 0.02` keep its word in ten random scenes?
- `multiple`: the light of two and more scatterings, which all methods leave out
"""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from rich.table import Table

from benchmarks import shaft_growth, shaft_methods, shaft_orders
from benchmarks.common import Outcome, available_cores, set_threads, tell_progress
from benchmarks.shaft_measures import warm_up

SCENES = ("ridge", "window", "lights")

Part = Callable[[argparse.Namespace], tuple[Any, tuple[Table, ...]]]

PARTS: Mapping[str, Part] = MappingProxyType(
    {
        "methods": shaft_methods.measure_methods,
        "stages": shaft_methods.measure_stages,
        "resolutions": shaft_methods.measure_resolutions,
        "equal_time": shaft_methods.measure_equal_time,
        "filter": shaft_methods.measure_filter,
        "taps": shaft_methods.measure_taps,
        "triangles": shaft_growth.measure_triangles,
        "lamps": shaft_growth.measure_lamps,
        "tolerance": shaft_growth.measure_tolerance,
        "multiple": shaft_orders.measure_orders,
    }
)
"""Each measures and shows one thing."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    parser.add_argument("--parts", nargs="+", default=tuple(PARTS), choices=tuple(PARTS), help="what to measure")
    parser.add_argument("--width", type=int, default=1920)
    parser.add_argument("--height", type=int, default=1080)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument(
        "--methods",
        nargs="+",
        default=shaft_methods.TIMED,
        choices=shaft_methods.TIMED,
        help="of the part methods, in their usual settings and refined",
    )
    parser.add_argument("--usual-only", action="store_true", help="not refined")
    parser.add_argument(
        "--repeats", type=int, default=3, help="timings of each method; runs beyond 20 s are not repeated"
    )
    parser.add_argument(
        "--truth-change", type=float, default=1e-3, help="relative change at which the truth has converged"
    )
    parser.add_argument("--whole-truth", action="store_true", help="of all pixels, however long it takes")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="for the drawings of time and error")
    parser.add_argument("--threads", type=int, default=available_cores())


def run(arguments: argparse.Namespace) -> Outcome:
    """Measure the parts that are asked for."""
    set_threads(arguments.threads)
    if arguments.quick:
        arguments.width, arguments.height, arguments.repeats, arguments.truth_change = 32, 18, 1, 0.05
    values: dict[str, Any] = {
        "width": arguments.width,
        "height": arguments.height,
        "threads": arguments.threads,
    }
    tables: list[Table] = []
    warm_up()
    for name in arguments.parts:
        tell_progress(name)
        values[name], shown = PARTS[name](arguments)
        tables += shown
    notes = (
        "seconds are those of the in-scattered light; the depth buffer and the shadow maps, the same for all, come on top",
        f"the truth: steps doubled until the light changes by less than {arguments.truth_change:.1%}",
    )
    return Outcome(values, tuple(tables), notes)
