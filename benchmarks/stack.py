"""How does the cost of a stack grow, and what would a general renderer need for the same table?

growth: volume, resolution, nodes and orders are varied around the standard preset on the procedural cumulus. loops: the same paths in the
fused loops and in torch. peers: Mitsuba's `volpath` at a few nodes, its time scaled to the stack's error and to all nodes of the table.
"""

import argparse
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import asdict, replace
from multiprocessing import get_context

from rich.table import Table

from benchmarks.common import (
    Outcome,
    available_cores,
    make_table,
    set_threads,
    show,
    spread,
    tell_progress,
)
from benchmarks.mitsuba_peer import VARIANTS
from benchmarks.parameter_sets import DEPTH
from benchmarks.stack_build import LOOPS, BuildCost, BuildTask, build
from benchmarks.stack_peers import compare_peers
from cloudfit.quality import QUALITIES, Quality
from precompute.error_budget import Effort
from render.depth_nodes import step_of_depths
from render.fused import fused_loops_wanted

SIDES = (64, 96, 128, 192, 256)

BASE_SIDE, WIDTH, HEIGHT = 128, 320, 240

SIZES = ((160, 120), (640, 480))

NODES = ((6, 6), (16, 16))

ORDERS = (4, 10, 34)

KEPT_RATIO = 1.5
"""A fused loop is kept only where torch takes more than so many times its seconds."""

QUICK_EFFORT = Effort(10, 500, 5_000, 4, True, 0.3)

QUICK_QUALITY = Quality(1.0, QUICK_EFFORT, QUICK_EFFORT, 3, 1.2, 10.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--quality", choices=QUALITIES, default="standard")
    parser.add_argument("--repeats", type=int, default=1, help="stacks of each row, with other seeds")
    parser.add_argument("--loop-paths", type=int, default=1_500_000, help="that each kind of loop traces, about")
    parser.add_argument("--compiled", action="store_true", help="compare with torch.compile too; needs a C++ compiler")
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), help="of Mitsuba")
    parser.add_argument("--samples", type=int, default=16, help="paths a pixel of Mitsuba's images")
    parser.add_argument("--pixels", type=int, default=400, help="that the path tracer traces")
    parser.add_argument("--traced", type=int, default=2_000_000, help="paths of each path-traced reference")
    parser.add_argument("--threads", type=int, default=available_cores())


def run(arguments: argparse.Namespace) -> Outcome:
    """Measure the parts that are asked for."""
    if arguments.quick:
        arguments.repeats, arguments.loop_paths, arguments.compiled = 1, 2_000, False
        arguments.samples, arguments.pixels, arguments.traced = 2, 20, 2_000
    set_threads(arguments.threads)
    values: dict[str, object] = {"settings": {name: getattr(arguments, name) for name in SETTINGS}}
    tables: list[Table] = []
    notes: list[str] = []
    # A process for each stack, so that the peak of one is not that of another; quick runs save the start.
    most = None if arguments.quick else 1
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=most) as pool:
        for part in arguments.parts:
            outcome = PARTS[part](arguments, pool)
            values[part] = outcome.values
            tables += outcome.tables
            notes += outcome.notes
    return Outcome(values, tuple(tables), tuple(notes))


SETTINGS = (
    "parts",
    "quality",
    "repeats",
    "loop_paths",
    "compiled",
    "variants",
    "samples",
    "pixels",
    "traced",
    "threads",
)


def base_task(arguments: argparse.Namespace) -> BuildTask:
    """The stack around which everything is varied."""
    if arguments.quick:
        return BuildTask(24, 32, 24, QUICK_QUALITY, 0, arguments.threads)
    return BuildTask(BASE_SIDE, WIDTH, HEIGHT, QUALITIES[arguments.quality], 0, arguments.threads)


def growth_tasks(base: BuildTask, quick: bool) -> list[tuple[str, str, BuildTask]]:
    """What is varied, its value, and the task; the base first."""
    quality, effort = base.quality, base.quality.table_effort
    tasks = [("base", f"{base.side}^3, {base.width} x {base.height}", base)]
    for side in (16,) if quick else SIDES:
        tasks.append(("voxels a side", str(side), replace(base, side=side)))
    for width, height in ((16, 12),) if quick else SIZES:
        tasks.append(("pixels", f"{width} x {height}", replace(base, width=width, height=height)))
    for asymmetries, extinctions in ((2, 3),) if quick else NODES:
        changed = replace(quality, asymmetry_nodes=asymmetries, extinction_step=step_of_depths(*DEPTH, extinctions))
        tasks.append(("nodes", f"{asymmetries} x {extinctions}", replace(base, quality=changed)))
    for orders in (4,) if quick else ORDERS:
        changed = replace(quality, table_effort=replace(effort, orders=orders, tail=orders > 4 and effort.tail))
        tasks.append(("orders", str(orders), replace(base, quality=changed)))
    return [task for number, task in enumerate(tasks) if number == 0 or task[2] != base]


def _measure_growth(arguments: argparse.Namespace, pool: Executor) -> Outcome:
    base = base_task(arguments)
    rows, values = [], []
    for knob, value, task in growth_tasks(base, arguments.quick):
        costs = [pool.submit(build, replace(task, seed=seed)).result() for seed in range(arguments.repeats)]
        summary = {name: spread(getattr(cost, name) for cost in costs) for name in MEASURES}
        rows.append((knob, value, *(_show(summary[name]) for name in MEASURES)))
        values.append({"knob": knob, "value": value, "summary": summary, "builds": [asdict(cost) for cost in costs]})
        tell_progress(
            f"{knob} {value}: {costs[0].seconds:.1f} s, {costs[0].peak_mb:.0f} MB, error {costs[0].error:.2%}"
        )
        if task == base:
            profile = costs[0]
    columns = ("varied", "value", *MEASURES.values())
    effort = base.quality.table_effort
    title = f"Growth around {base.side}^3 voxels, {base.width} x {base.height} pixels, {_nodes(base)} nodes, {effort.orders} orders"
    notes = (
        f"growth: each row is the base but for what is varied, and {_times(arguments.repeats)}; the base's tolerance holds in all "
        "rows, so what is harder takes more paths",
        "error: what eleven of twelve nodes and albedos do not exceed in the worst group, as the stack states; peak: of a process that "
        "builds this one stack, with the imports",
    )
    share = {part: seconds / sum(profile.parts.values()) for part, seconds in profile.parts.items()}
    profile_rows = [
        (part, profile.parts[part], f"{share[part]:.1%}") for part in sorted(share, key=lambda p: -share[p])
    ]
    tables = (
        make_table(title, columns, rows),
        make_table("Seconds of the base", ("part", "seconds", "share"), profile_rows),
    )
    return Outcome({"rows": values, "profile": profile.parts}, tables, notes)


MEASURES = {
    "seconds": "seconds",
    "paths": "paths",
    "peak_mb": "peak, MB",
    "table_mb": "tables, MB",
    "error": "error",
    "error_median": "median error",
}
"""Numbers of a `BuildCost` that are shown, and their headings."""


def _nodes(task: BuildTask) -> str:
    return f"{task.quality.asymmetry_nodes} x {len(task.quality.place_depths(*DEPTH))}"


def _show(summary: dict[str, float]) -> str:
    """A number that was measured once has no quartiles."""
    return f"{summary['median']:.4g}" if summary["count"] == 1 else show(summary)


def _times(repeats: int) -> str:
    return "measured once" if repeats == 1 else f"measured with {repeats} seeds"


def _compare_loops(arguments: argparse.Namespace, pool: Executor) -> Outcome:
    if not fused_loops_wanted():
        return Outcome({"skipped": True}, (), ("loops: skipped, the fused loops are not installed or turned off",))
    base = base_task(arguments)
    effort = replace(base.quality.table_effort, paths=arguments.loop_paths, tolerance=None)
    task = replace(base, quality=replace(base.quality, table_effort=effort))
    costs: dict[str, BuildCost] = {}
    notes = [f"loops: a fused loop is kept where torch takes more than {KEPT_RATIO:g} times as long"]
    for loops in LOOPS:
        if loops == "compiled" and not arguments.compiled:
            continue
        try:
            costs[loops] = pool.submit(build, replace(task, loops=loops)).result()
        except Exception as error:  # whatever a compiler may raise is an answer too
            notes.append(f"{loops} loops did not work here: {str(error).strip().splitlines()[0]}")
            continue
        tell_progress(
            f"{loops} loops: {costs[loops].seconds:.1f} s after {costs[loops].warm_up_seconds:.1f} s of warming up"
        )
    rows = [_loop_row(part, {name: cost.parts[part] for name, cost in costs.items()}) for part in costs["fused"].parts]
    rows.append(_loop_row("all", {name: cost.seconds for name, cost in costs.items()}))
    rows.append(["first use", *(cost.warm_up_seconds for cost in costs.values()), *[""] * (len(costs) - 1)])
    others = [name for name in costs if name != "fused"]
    columns = ("part", *(f"{name}, s" for name in costs), *(f"{name} / fused" for name in others))
    notes.append(f"all loops trace the same {costs['fused'].paths} paths; at least four for each source point")
    notes += [_verdict(name, cost, costs["fused"]) for name, cost in costs.items() if name != "fused"]
    values = {name: asdict(cost) for name, cost in costs.items()}
    return Outcome(values, (make_table("The same paths in several loops", columns, rows),), tuple(notes))


def _loop_row(part: str, seconds: dict[str, float]) -> list[object]:
    ratios = [spent / max(seconds["fused"], 1e-9) for name, spent in seconds.items() if name != "fused"]
    return [part, *seconds.values(), *ratios]


def _verdict(name: str, cost: BuildCost, fused: BuildCost) -> str:
    ratio, total = cost.parts["paths"] / fused.parts["paths"], cost.seconds / fused.seconds
    kept = "is kept" if ratio > KEPT_RATIO else "is not worth keeping"
    return f"{name} takes {ratio:.1f} times as long for the paths, {total:.1f} times for the whole stack: the fused loop {kept}"


def _compare_peers(arguments: argparse.Namespace, pool: Executor) -> Outcome:
    return compare_peers(arguments, base_task(arguments), pool)


PARTS = {"growth": _measure_growth, "loops": _compare_loops, "peers": _compare_peers}
