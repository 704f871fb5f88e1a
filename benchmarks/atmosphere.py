"""What do an atmosphere's tables cost in time, mode by mode and stage by stage, and how far is the sky from the truth?

Two modes: `parity`, the tables and quadratures of Bruneton's reference, and `accurate`, the source function with integrals along each
ray, at several sizes. At the same random rays (the sun 0 to 88 degrees from the zenith, the camera between the ground and 9 km, views above
and below the horizon) both are compared with the converged integral of light scattered once and with paths of all that is scattered more
often.
"""

import argparse
import math
import statistics
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from rich.table import Table
from torch import Tensor

from benchmarks.common import (
    SHARED,
    Outcome,
    available_cores,
    make_table,
    peak_memory_mb,
    set_threads,
    stopwatch,
    tell_progress,
)
from precompute.atmosphere.source_budget import build_source_function
from precompute.atmosphere.source_function import SourceSizes, compute_orders
from precompute.atmosphere_tables import TablePlan, build_atmosphere_tables, build_first_order, build_next_order
from render.atmosphere.accurate_sky import integrate_single_scattering, integrate_source
from render.atmosphere.air_ray import AirRay
from render.atmosphere.earth import earth
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.path_tracer import trace_atmosphere
from render.atmosphere.ray_quadrature import place_nodes
from render.atmosphere.rays import rays_from_vectors
from render.atmosphere.shells import cut_into_shells
from render.atmosphere.single_scattering import compute_single_radiance
from render.atmosphere.sky import look_up_sky_radiance
from render.atmosphere.sun_columns import build_sun_columns
from render.atmosphere.tables import TableSizes
from render.units import radians_from_degrees

SMALL_TABLES = TableSizes(16, 64, 4, 16, 8, 32, 4, 8)
"""Those of the small golden tables; quick runs build no larger ones."""

SCALES = (0.5, 0.71, 1.0)
"""Of the default sizes of the source function."""

QUICK_SCALES = (0.2,)

REPEATS = 5
"""Batches of rays that are timed."""

FOLDER = SHARED / "golden" / "bruneton"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    parser.add_argument("--rays", type=int, default=40, help="at which the modes are compared with the truth")
    parser.add_argument("--paths", type=int, default=20_000, help="of the truth, for each ray")
    parser.add_argument("--orders", type=int, default=4, help="of scattering")
    parser.add_argument("--tolerance", type=float, default=0.01, help="of the accurate mode's own choice of sizes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=available_cores())


@dataclass(frozen=True, eq=False)
class Truth:
    """Rays and their light.

    Args:
        position, view, sun: vectors `(ray, 3)`.
        once: radiance scattered once `(ray, wavelength)` [W/m^2/sr/nm].
        often: radiance of orders 2 and up `(ray, wavelength)`, and its standard error.
        often_error: that standard error.
    """

    position: Tensor
    view: Tensor
    sun: Tensor
    once: Tensor
    often: Tensor
    often_error: Tensor

    def rays(self, planet: AtmosphereParameters) -> AirRay:
        """The rays."""
        return rays_from_vectors(planet, self.position, self.view, self.sun)

    def errors(self, once: Tensor, often: Tensor) -> dict[str, dict[str, float]]:
        """Errors of light scattered once, more often, and in all, relative to each."""
        whole = self.once + self.often
        return {
            "once": _spread(once / self.once - 1.0),
            "often": _spread(often / self.often - 1.0),
            "whole": _spread((once + often) / whole - 1.0),
        }


@dataclass(frozen=True)
class Measured:
    """One way to a sky: seconds of its stages, microseconds of a ray, megabytes kept, and errors."""

    name: str
    stages: dict[str, float]
    ray_us: float
    table_mb: float
    errors: dict[str, dict[str, float]]

    @property
    def seconds(self) -> float:
        """Of all stages."""
        return sum(self.stages.values())


def run(arguments: argparse.Namespace) -> Outcome:
    """Trace the truth, build in both modes, compare."""
    if arguments.quick:
        arguments.rays, arguments.paths, arguments.orders, arguments.tolerance = 6, 40, 3, 0.9
    set_threads(arguments.threads)
    planet = earth()
    with stopwatch() as seconds:
        truth = make_truth(planet, arguments.rays, arguments.paths, arguments.orders, arguments.seed)
    noise = float((truth.often_error / truth.often).median())
    tell_progress(f"truth: {seconds[0]:.0f} s, noise of orders 2 and up {noise:.2%}")
    sizes = SMALL_TABLES if arguments.quick else TableSizes()
    measured = [measure_tables(planet, truth, sizes, arguments.orders)]
    for scale in QUICK_SCALES if arguments.quick else SCALES:
        measured.append(
            measure_source(planet, truth, SourceSizes().scaled(scale), f"accurate x {scale}", arguments.orders)
        )
        tell_progress(f"{measured[-1].name}: {measured[-1].seconds:.1f} s")
    values: dict[str, object] = {
        "settings": {name: getattr(arguments, name) for name in ("rays", "paths", "orders", "seed", "threads")},
        "truth_seconds": seconds[0],
        "noise_median": noise,
        "measured": [{**vars(one), "seconds": one.seconds} for one in measured],
        "parity": parity_errors() if FOLDER.exists() else None,
        "peak_memory_mb": peak_memory_mb(),
    }
    if not arguments.quick:
        values["to_tolerance"] = _to_tolerance(planet, arguments.tolerance, arguments.orders)
    notes = [
        f"truth: {arguments.paths} paths a ray; the median standard error of orders 2 and up is {noise:.2%}",
        "errors: median and 95th percentile over rays and wavelengths, relative; `whole` is the sum of all orders",
        "a ray: of a batch of 4096, all in",
        "parity: largest difference from the golden small tables, relative to the peak of each; needs the shared data",
    ]
    return Outcome(values, (_table(measured, arguments), _parity_table(values["parity"])), tuple(notes))


def make_truth(planet: AtmosphereParameters, count: int, paths: int, orders: int, seed: int) -> Truth:
    """Random rays with their light; the same seed gives the same rays."""
    uniform = torch.rand(4, count, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    altitude = torch.tensor([1.0, 200.0, 1000.0, 3000.0, 9000.0], dtype=torch.float64)[torch.arange(count) % 5]
    zenith = radians_from_degrees(88.0) * uniform[0].sqrt()
    cosine = torch.where(torch.arange(count) % 4 == 3, -0.05 - 0.95 * uniform[1], uniform[1] ** 1.5)
    sine, turn = (1.0 - cosine * cosine).sqrt(), 2.0 * math.pi * uniform[2]
    zero = torch.zeros_like(zenith)
    sun = torch.stack([torch.sin(zenith), zero, torch.cos(zenith)], -1)
    view = torch.stack([sine * torch.cos(turn), sine * torch.sin(turn), cosine], -1)
    position = torch.stack([zero, zero, planet.bottom_radius + altitude], -1)
    once = compute_single_radiance(cut_into_shells(planet), rays_from_vectors(planet, position, view, sun))
    traced = trace_atmosphere(planet, position, view, sun, orders=orders, paths=paths, seed=seed)
    often = traced.orders[..., 1:].sum(-1)
    # The first order is nearly free of noise beside the others, so the error of the sum stands for theirs.
    return Truth(position, view, sun, once, often, traced.radiance_error)


def measure_tables(planet: AtmosphereParameters, truth: Truth, sizes: TableSizes, orders: int) -> Measured:
    """The tables of the reference."""
    plan = TablePlan(sizes=sizes, orders=orders)
    stages: dict[str, float] = {}
    with stopwatch() as seconds:
        state = build_first_order(planet, plan)
    stages["order 1"] = seconds[0]
    first = state.tables(planet)
    for order in range(2, orders + 1):
        with stopwatch() as seconds:
            state = build_next_order(planet, plan, state)
        stages[f"order {order}"] = seconds[0]
        tell_progress(f"parity, order {order}: {seconds[0]:.1f} s")
    tables = state.tables(planet)
    vectors = (truth.position, truth.view, truth.sun)
    once = look_up_sky_radiance(first, *vectors).radiance.double()
    whole = look_up_sky_radiance(tables, *vectors).radiance.double()
    kept = (tables.transmittance, tables.irradiance, tables.scattering, tables.single_mie)
    look_up = _time_of_ray(lambda some: look_up_sky_radiance(tables, *(value[some] for value in vectors)), len(once))
    return Measured("parity", stages, look_up, _megabytes(*kept), truth.errors(once, whole - once))


def measure_source(planet: AtmosphereParameters, truth: Truth, sizes: SourceSizes, name: str, orders: int) -> Measured:
    """The source function at given sizes."""
    stages: dict[str, float] = {}
    shells = cut_into_shells(planet)
    with stopwatch() as seconds:
        columns = build_sun_columns(shells)
    stages["columns"] = seconds[0]
    total = torch.zeros(())
    later: Iterator = compute_orders(shells, sizes, columns)
    for order in range(2, orders + 1):
        with stopwatch() as seconds:
            total = total + next(later).source
        stages[f"order {order}"] = seconds[0]
    rays = truth.rays(planet)

    def light(some: AirRay) -> tuple[Tensor, Tensor]:
        nodes = place_nodes(shells, some, some.length(planet), sizes.view_nodes)
        once = integrate_single_scattering(shells, columns, some, nodes)
        return once, integrate_source(shells, total, some, nodes)

    def light_of(some: Tensor) -> object:
        return light(AirRay(*(value[some] for value in rays.tensors())))

    per_ray = _time_of_ray(light_of, len(truth.once))
    return Measured(name, stages, per_ray, _megabytes(total, columns.columns), truth.errors(*light(rays)))


def parity_errors() -> dict[str, float]:
    """Largest differences from the golden small tables, relative to the largest number of each."""
    tables = build_atmosphere_tables(earth(), TablePlan(sizes=SMALL_TABLES, precision="float64"))
    with np.load(FOLDER / "textures_small.npz") as golden:
        return {
            name: _distance(values, golden[array])
            for name, values, array in (
                ("transmittance", tables.transmittance, "transmittance"),
                ("irradiance", tables.irradiance, "irradiance_sum_init4"),
                ("scattering", tables.scattering, "scattering_sum_4"),
                ("single aerosol scattering", tables.single_mie, "delta_mie"),
            )
        }


def _distance(values: Tensor, golden: np.ndarray) -> float:
    return float(np.abs(values.double().numpy().reshape(golden.shape) - golden).max() / golden.max())


def _spread(errors: Tensor) -> dict[str, float]:
    size = errors.abs().flatten()
    return {"median": float(size.median()), "p95": float(size.quantile(0.95)), "bias": float(errors.median())}


def _megabytes(*tables: Tensor) -> float:
    return sum(table.numel() * table.element_size() for table in tables) / 1e6


def _time_of_ray(light: Callable[[Tensor], object], rays: int, batch: int = 4096) -> float:
    """Microseconds of a ray, in a batch, median of some."""
    some = torch.arange(batch) % rays
    found = []
    for _ in range(REPEATS):
        with stopwatch() as seconds:
            light(some)
        found.append(1e6 * seconds[0] / batch)
    return statistics.median(found)


def _to_tolerance(planet: AtmosphereParameters, tolerance: float, orders: int) -> dict[str, object]:
    _, report = build_source_function(planet, tolerance=tolerance, orders=orders)
    return {"tolerance": tolerance, **{**vars(report), "sizes": vars(report.sizes)}}


def _table(measured: list[Measured], arguments: argparse.Namespace) -> Table:
    columns = ("mode", "seconds", "us a ray", "MB", "once", "p95", "orders 2..", "p95", "whole", "p95")
    rows = [
        (
            one.name,
            one.seconds,
            one.ray_us,
            one.table_mb,
            *(f"{one.errors[light][of]:.2%}" for light in ("once", "often", "whole") for of in ("median", "p95")),
        )
        for one in measured
    ]
    return make_table(f"Earth, {arguments.orders} orders, {arguments.threads} threads", columns, rows)


def _parity_table(parity: object) -> Table:
    rows = [(name, f"{error:.1e}") for name, error in parity.items()] if isinstance(parity, dict) else []
    return make_table("Distance from the golden small tables", ("table", "of the peak"), rows)
