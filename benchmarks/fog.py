"""What does fog in closed form save over marching along the rays, at which error?

The view of the plain that `cloudfit fog` shows, through each medium: every pixel's ray to the ground, or 20 km far into
the sky. The march takes the midpoints of equal steps, as renderers do, and sums in float32. It is told where the fog ends,
where nothing more is to be seen, and the optical depth to the sun from every midpoint in closed form, so it is spared the
second loop that a medium without one needs. Both are compared with Gauss-Legendre quadrature in float64. Steps are doubled
until 95 % of the pixels meet a relative error.
"""

import argparse
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from rich.table import Table
from torch import Tensor

from benchmarks.common import (
    Outcome,
    available_cores,
    make_table,
    set_threads,
    show,
    spread,
    stopwatch,
    tell_progress,
)
from cloudfit.fog_picture import aim_camera, view_rays
from render.media import (
    MEDIA,
    LayeredMedium,
    compute_curved_in_scattering,
    compute_in_scattering,
    extinction_from_visibility,
    find_distance,
    ground_distance,
)
from render.media.layer import light_depth
from render.media.sphere import EARTH_RADIUS

EYE, FARTHEST = 12.0, 20_000.0
"""Height of the eye and length of the rays that meet no ground [m]."""

FOG_HEIGHT, VISIBILITY = 60.0, 300.0
"""Of each medium [m]."""

SUN_ELEVATION_DEG = 25.0

TOLERANCES = (0.1, 0.01, 0.001, 0.0001)
"""Relative errors that the march is to reach."""

DEEPEST = 16.0
"""Optical depth at which the march stops: exp(-16) is 1e-7."""

MOST_STEPS = 1 << 11

SHARE = 0.95
"""Share of the pixels that have to meet the error."""

CHUNK = 1 << 14
"""Rays at once, for both: their numbers stay in the cache."""

REFERENCE_PANELS, REFERENCE_NODES = 64, 24
"""Of the quadrature; panels are finer towards the eye."""

Method = Callable[[LayeredMedium, Tensor, Tensor], Tensor]
"""Medium, slopes (ray,) and distances (ray,) -> in-scattering (ray,)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this benchmark."""
    parser.add_argument("--repeats", type=int, default=9, help="timings of each method")
    parser.add_argument("--threads", type=int, default=available_cores())


def run(arguments: argparse.Namespace) -> Outcome:
    """Measure every medium."""
    set_threads(arguments.threads)
    repeats = 2 if arguments.quick else arguments.repeats
    size = (32, 24) if arguments.quick else (320, 180)
    most = 64 if arguments.quick else MOST_STEPS
    slope, distance = rays_of_view(*size)
    media: dict[str, Any] = {}
    for name in MEDIA:
        tell_progress(name)
        media[name] = measure_medium(build_medium(name), slope, distance, repeats, most)
    values = {"threads": arguments.threads, "rays": len(slope), "share_within_error": SHARE, "media": media}
    return Outcome(values, tables_of(media), notes_of(most))


def build_medium(name: str) -> LayeredMedium:
    """The medium of that name."""
    return MEDIA[name](extinction_from_visibility(VISIBILITY), FOG_HEIGHT)


def rays_of_view(width: int, height: int) -> tuple[Tensor, Tensor]:
    """Slopes and lengths [m] of the rays of all pixels `(ray,)`, float32."""
    directions = view_rays(aim_camera(0.0, math.radians(3.0), math.radians(38.0), (width, height)))
    slope = directions[..., 2].flatten().float()
    return slope, ground_distance(EYE, slope).clamp(max=FARTHEST)


def closed_form(medium: LayeredMedium, slope: Tensor, distance: Tensor) -> Tensor:
    """Over flat ground."""
    return compute_in_scattering(medium, EYE, slope, _sun_slope(), distance)


def closed_form_round(medium: LayeredMedium, slope: Tensor, distance: Tensor) -> Tensor:
    """With the sun's path over round ground."""
    return compute_curved_in_scattering(medium, EYE, slope, _sun_slope(), EARTH_RADIUS, distance)


def march(steps: int) -> Method:
    """The march with so many equal steps."""

    def method(medium: LayeredMedium, slope: Tensor, distance: Tensor) -> Tensor:
        deepest = find_distance(medium, EYE, slope, DEEPEST)
        step = torch.minimum(torch.minimum(distance, _way_out(medium, slope)), deepest) / steps
        total, before = torch.zeros_like(step), torch.zeros_like(step)
        sun_slope = torch.tensor(_sun_slope(), dtype=slope.dtype)
        for number in range(steps):
            density, light = _medium_at(medium, EYE + slope * step * (number + 0.5), sun_slope)
            depth = density * step
            total = total + depth * torch.exp(-(before + 0.5 * depth + light))
            before = before + depth
        return total

    return method


def _way_out(medium: LayeredMedium, slope: Tensor) -> Tensor:
    """Distance [m] at which rays leave the layer."""
    level = slope == 0.0
    border = torch.where(slope > 0.0, medium.top - EYE, medium.base - EYE)
    return torch.where(level, math.inf, border / torch.where(level, 1.0, slope))


def _medium_at(medium: LayeredMedium, height: Tensor, sun_slope: Tensor) -> tuple[Tensor, Tensor]:
    """Extinction [1/m] and optical depth to the sun [1] at heights [m]."""
    level = height - medium.datum
    inside = (height >= medium.base) & (height <= medium.top)
    within = torch.where(inside, level, torch.as_tensor(medium.base - medium.datum, dtype=level.dtype))
    density = torch.where(inside, medium.extinction_at(within), 0.0)
    return density, torch.where(inside, light_depth(medium, within, sun_slope), 0.0)


def reference(medium: LayeredMedium, slope: Tensor, distance: Tensor) -> Tensor:
    """Quadrature in float64 within the layer, by heights and extinctions alone."""
    slope, distance = slope.double(), distance.double()
    length = torch.minimum(distance, _way_out(medium, slope))
    nodes, weights = np.polynomial.legendre.leggauss(REFERENCE_NODES)
    edges = np.concatenate([[0.0], np.logspace(-6.0, 0.0, REFERENCE_PANELS)])
    size = np.diff(edges)
    cumulative = _cumulative_weights(nodes, weights)
    total, before = torch.zeros_like(length), torch.zeros_like(length)
    sun_slope = torch.tensor(_sun_slope(), dtype=torch.float64)
    for low, width in zip(edges[:-1], size, strict=True):
        t = length[:, None] * torch.from_numpy(low + width * 0.5 * (nodes + 1.0))
        density, light = _medium_at(medium, EYE + slope[:, None] * t, sun_slope)
        depth = density * (length * width)[:, None]
        within = before[:, None] + depth @ torch.from_numpy(cumulative.T)
        weight = torch.from_numpy(0.5 * weights)
        total = total + (depth * torch.exp(-within - light)) @ weight
        before = before + depth @ weight
    return total


def _cumulative_weights(nodes: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Integrals over the unit interval of the interpolating polynomial from 0 to each node."""
    legendre = np.polynomial.legendre
    columns = []
    for order in range(len(nodes)):
        antiderivative = legendre.legint(np.eye(len(nodes))[order], lbnd=-1.0)
        columns.append(0.5 * legendre.legval(nodes, antiderivative))
    analysis = np.array(
        [(2 * k + 1) / 2.0 * weights * legendre.legval(nodes, np.eye(len(nodes))[k]) for k in range(len(nodes))]
    )
    return np.stack(columns, axis=1) @ analysis


def _sun_slope() -> float:
    return math.sin(math.radians(SUN_ELEVATION_DEG))


def in_chunks(method: Method, medium: LayeredMedium, slope: Tensor, distance: Tensor) -> Tensor:
    """A method over all rays, a chunk at a time."""
    chunks = zip(slope.split(CHUNK), distance.split(CHUNK), strict=True)
    return torch.cat([method(medium, *chunk) for chunk in chunks])


def measure_medium(medium: LayeredMedium, slope: Tensor, distance: Tensor, repeats: int, most: int) -> dict[str, Any]:
    """Errors of the march by steps, then the time of each method that a row of the table needs, in turns."""
    truth = in_chunks(reference, medium, slope, distance)
    errors: dict[int, dict[str, float]] = {}
    steps = 4
    while steps <= most:
        errors[steps] = error_of(march(steps), medium, slope, distance, truth)
        if errors[steps]["percentile"] < TOLERANCES[-1]:
            break
        steps *= 2
    needed = {tolerance: steps_for(errors, tolerance) for tolerance in TOLERANCES}
    methods: dict[str, Method] = {"closed form": closed_form, "closed form, round ground": closed_form_round}
    methods |= {f"march {count}": march(count) for count in sorted({count for count in needed.values() if count})}
    seconds = time_in_turns(methods, medium, slope, distance, repeats)
    double = error_of(closed_form, medium, slope.double(), distance.double(), truth)
    return {
        "closed_form_error": error_of(closed_form, medium, slope, distance, truth),
        "closed_form_error_float64": double,
        "round_ground_difference": error_of(closed_form_round, medium, slope, distance, truth),
        "march_errors": {str(count): error for count, error in errors.items()},
        "steps_for": {str(tolerance): count for tolerance, count in needed.items()},
        "nanoseconds_per_ray": {name: spread(1e9 * s / len(slope) for s in values) for name, values in seconds.items()},
    }


def error_of(method: Method, medium: LayeredMedium, slope: Tensor, distance: Tensor, truth: Tensor) -> dict[str, float]:
    """Relative error: median, that which `SHARE` of the rays meet, and the largest."""
    value = in_chunks(method, medium, slope, distance).double()
    error = ((value - truth).abs() / truth).sort().values
    return {
        "median": float(error[len(error) // 2]),
        "percentile": float(error[int(SHARE * (len(error) - 1))]),
        "largest": float(error[-1]),
    }


def steps_for(errors: Mapping[int, dict[str, float]], tolerance: float) -> int | None:
    """Fewest steps tried that meet the tolerance, or None."""
    return next((count for count, error in errors.items() if error["percentile"] <= tolerance), None)


def time_in_turns(
    methods: Mapping[str, Method], medium: LayeredMedium, slope: Tensor, distance: Tensor, repeats: int
) -> dict[str, list[float]]:
    """Seconds of each method, all of them once in every repetition; the first one is left out."""
    seconds: dict[str, list[float]] = {name: [] for name in methods}
    for repeat in range(repeats + 1):
        for name, method in methods.items():
            with stopwatch() as passed:
                in_chunks(method, medium, slope, distance)
            if repeat:
                seconds[name] += passed
    return seconds


def tables_of(media: Mapping[str, Any]) -> tuple[Table, ...]:
    """The measurements to read."""
    errors = make_table(
        f"relative error that {SHARE:.0%} of the rays meet",
        ("medium", "closed form, float64", "closed form", *(f"march for {t:g}" for t in TOLERANCES)),
        [
            (
                name,
                row["closed_form_error_float64"]["percentile"],
                row["closed_form_error"]["percentile"],
                *(_steps(row, tolerance) for tolerance in TOLERANCES),
            )
            for name, row in media.items()
        ],
    )
    times = make_table(
        "nanoseconds a ray, median [quartiles], and times the closed form's",
        ("medium", "closed form", "over round ground", *(f"march for {t:g}" for t in TOLERANCES)),
        [_time_row(name, row) for name, row in media.items()],
    )
    return errors, times


def _steps(row: Mapping[str, Any], tolerance: float) -> str:
    count = row["steps_for"][str(tolerance)]
    return "not reached" if count is None else f"{count} steps"


def _time_row(name: str, row: Mapping[str, Any]) -> tuple[str, ...]:
    times = row["nanoseconds_per_ray"]
    cells = [name, show(times["closed form"]), show(times["closed form, round ground"])]
    for tolerance in TOLERANCES:
        count = row["steps_for"][str(tolerance)]
        marched = None if count is None else times[f"march {count}"]
        ratio = 0.0 if marched is None else marched["median"] / times["closed form"]["median"]
        cells.append("not reached" if marched is None else f"{show(marched)} ({ratio:.3g} x)")
    return tuple(cells)


def notes_of(most: int) -> tuple[str, ...]:
    """What was measured how."""
    return (
        f"visibility {VISIBILITY:g} m, fog height {FOG_HEIGHT:g} m, eye at {EYE:g} m, sun {SUN_ELEVATION_DEG:g} degrees high",
        f"the march was tried with up to {most} steps; 'not reached' means that these did not meet the error",
        "the march is told where the fog ends and stops at an optical depth of 16; it takes the depth to the sun in closed form, "
        "and would need a second march without",
        "each method runs once in each repetition, in chunks of the same size, in eager torch and float32",
        "the closed form costs the same for every error; a march of very few steps is faster",
    )
