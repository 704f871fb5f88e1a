"""How fine and how far: a source function that meets a tolerance, in size and in orders of scattering.

The error is measured, not promised. Probe rays are placed at three altitudes, under five suns, in directions from the zenith to just
beside the horizon, above and below. The table is built coarsely, then with sqrt(2) times the intervals of every axis, and so on, until
the light of the probes changes by less than the tolerance; since linear interpolation errs by the square of the interval, what the last
refinement changed is about what is still wrong. Orders are added until those beyond, continued as a geometric series, are
worth less than half of the tolerance.
"""

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from precompute.atmosphere.source_function import OrderOfLight, SourceSizes, compute_orders
from render.atmosphere.accurate_sky import integrate_single_scattering, integrate_source
from render.atmosphere.air_ray import AirRay
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.ray_geometry import clamp_cosine, horizon_cosine, sine_from_cosine
from render.atmosphere.ray_quadrature import RayNodes, place_nodes
from render.atmosphere.shells import Shells, cut_into_shells
from render.atmosphere.source_function import SourceFunction
from render.atmosphere.sun_columns import SunColumns, build_sun_columns
from render.cornette_shanks import evaluate_cornette_shanks
from render.errors import ParameterError
from render.spherical_harmonics import compute_phase_moments

Progress = Callable[[str, float], None]
"""Is told a stage and its share done, 0..1."""

FINEST = 4.0
"""Largest factor by which the default sizes are refined; a table of it takes some minutes an order."""

STEP = math.sqrt(2.0)

COARSEST = 0.5

MOST_ORDERS = 300
"""Orders beyond which even an air that absorbs nothing has given up its light."""

LARGEST_DEGREE = 96

PROBE_NODES = 32
"""Nodes of each leg of a probe ray, more than any source function has: they see the rule of the table's own rays, too."""


@dataclass(frozen=True)
class SourceReport:
    """What was built, and how good it is.

    Args:
        sizes: of the table.
        orders: largest number of scatterings.
        error: relative RMS change of the probes' light of orders 2 and up by the last refinement; None where sizes were given.
        remainder: estimated share of that light that higher orders would add.
        met: whether the error is within the tolerance, and the remainder, unless the orders were given.
        seconds: of the whole build.
    """

    sizes: SourceSizes
    orders: int
    error: float | None
    remainder: float
    met: bool
    seconds: float


def build_source_function(
    atmosphere: AtmosphereParameters,
    *,
    tolerance: float = 0.01,
    orders: int | None = None,
    sizes: SourceSizes | None = None,
    on_progress: Progress = lambda stage, share: None,
) -> tuple[SourceFunction, SourceReport]:
    """Fill a source function.

    Args:
        atmosphere: the planet.
        tolerance: accepted relative RMS error of the light scattered more than once, at probe rays.
        orders: of scattering, at least 2; as many as the tolerance needs by default.
        sizes: of the table; as the tolerance needs by default.
        on_progress: is told what is being done.

    Returns:
        The source function, and a report of what it took.

    Raises:
        ParameterError: for a tolerance that is not positive, or fewer than two orders.
    """
    if not tolerance > 0.0 or (orders is not None and orders < 2):
        raise ParameterError(f"need a positive tolerance and at least two orders, not {tolerance} and {orders}")
    started = time.perf_counter()
    shells = cut_into_shells(atmosphere)
    columns = build_sun_columns(shells)
    probes = _Probes.place(shells)
    plan = _Plan(shells, columns, probes, tolerance, orders, on_progress)
    if sizes is not None:
        built = plan.build(sizes)
        return built.source, built.report(None, plan, started)
    base = sizes_for(atmosphere, tolerance)
    factor, error = COARSEST, math.inf
    built = plan.build(base.scaled(factor))
    while error > tolerance and factor * STEP <= FINEST * 1.001:
        factor *= STEP
        coarse, built = built.light, plan.build(base.scaled(factor))
        error = _relative_rms(coarse - built.light, built.light)
    return built.source, built.report(error, plan, started)


def sizes_for(atmosphere: AtmosphereParameters, tolerance: float) -> SourceSizes:
    """Default sizes with the degree that the aerosols' lobe asks for.

    The degree is the smallest l above which (2 l + 1) chi_l^2 is less than a tenth of the tolerance of its sum over l: what the cut
    takes from the light scattered twice next to the sun.
    """
    asymmetry = atmosphere.mie_asymmetry
    chi = compute_phase_moments(lambda c: evaluate_cornette_shanks(c, asymmetry), LARGEST_DEGREE)
    share = (2.0 * torch.arange(LARGEST_DEGREE + 1) + 1.0) * chi.square()
    needed = (share > 0.1 * tolerance * share.sum()).nonzero()
    degree = max(int(needed.max()) if len(needed) else 0, 2)
    return replace(SourceSizes(), degree=degree, turns=max(SourceSizes().turns, math.ceil(0.8 * degree)))


@dataclass(frozen=True, eq=False)
class _Probes:
    """Rays that judge, and their nodes."""

    shells: Shells
    rays: AirRay
    nodes: RayNodes

    @staticmethod
    def place(shells: Shells) -> "_Probes":
        planet = shells.atmosphere
        found = []
        heights = [share * planet.thickness for share in (0.0, 0.016, 0.15)]
        suns = [math.cos(math.radians(angle)) for angle in (15.0, 45.0, 70.0, 84.0, 89.0)]
        for height, sun in itertools.product(heights, suns):
            distance = planet.bottom_radius + height
            horizon = float(horizon_cosine(planet, torch.tensor(distance, dtype=torch.float64)))
            views = [1.0, 0.7, 0.3, horizon + 0.1, horizon + 0.01] + ([horizon - 0.03, -0.6] if height else [])
            for view, turn in itertools.product(views, (0.0, 0.5 * math.pi, math.pi)):
                found.append((distance, view, sun, math.cos(turn)))
        radius, cos_view, cos_sun, cos_turn = torch.tensor(found, dtype=torch.float64).unbind(-1)
        across = sine_from_cosine(cos_view) * sine_from_cosine(cos_sun) * cos_turn
        rays = AirRay.towards(planet, radius, cos_view, cos_sun, clamp_cosine(cos_view * cos_sun + across))
        return _Probes(shells, rays, place_nodes(shells, rays, rays.length(planet), PROBE_NODES))

    def light(self, source: Tensor) -> Tensor:
        """What they see of a source `(ray, wavelength)` [W/m^2/sr/nm]."""
        return integrate_source(self.shells, source, self.rays, self.nodes)

    def light_scattered_once(self, columns: SunColumns) -> Tensor:
        """What they see of the first order `(ray, wavelength)` [W/m^2/sr/nm]."""
        return integrate_single_scattering(self.shells, columns, self.rays, self.nodes)


@dataclass(frozen=True, eq=False)
class _Built:
    """A source function, what the probes see of it, and the share that is missing."""

    source: SourceFunction
    light: Tensor
    sizes: SourceSizes
    remainder: float

    def report(self, error: float | None, plan: "_Plan", started: float) -> SourceReport:
        tolerance, chosen = plan.tolerance, plan.orders is not None
        met = (error is None or error <= tolerance) and (chosen or self.remainder <= tolerance)
        seconds = time.perf_counter() - started
        return SourceReport(self.sizes, self.source.orders, error, self.remainder, met, seconds)


@dataclass(frozen=True, eq=False)
class _Plan:
    """What all builds share."""

    shells: Shells
    columns: SunColumns
    probes: _Probes
    tolerance: float
    orders: int | None
    on_progress: Progress

    def build(self, sizes: SourceSizes) -> _Built:
        """Add order after order until there are as many as asked for, or enough."""
        most = self.orders or MOST_ORDERS
        orders = compute_orders(self.shells, sizes, self.columns)
        total = next(orders)
        before, last = self.probes.light_scattered_once(self.columns), self.probes.light(total.source)
        light, remainder = last, _remainder(before, last, last)
        while total.order < most and not (self.orders is None and remainder <= 0.5 * self.tolerance):
            self.on_progress(f"order {total.order}, {sizes.altitudes} altitudes", min(total.order / most, 1.0))
            one = next(orders)
            before, last = last, self.probes.light(one.source)
            light, total = light + last, _sum(total, one)
            remainder = _remainder(before, last, light)
        self.on_progress(f"order {total.order}, {sizes.altitudes} altitudes", 1.0)
        source = SourceFunction(
            self.shells, self.columns, total.source, total.sky_irradiance, total.order, sizes.view_nodes
        )
        return _Built(source, light, sizes, remainder)


def _sum(total: OrderOfLight, one: OrderOfLight) -> OrderOfLight:
    return OrderOfLight(one.order, total.source + one.source, total.sky_irradiance + one.sky_irradiance)


def _remainder(before: Tensor, last: Tensor, light: Tensor) -> float:
    """Share of the light that all later orders would add, if each were to the one before as the last two are."""
    if not bool((last > 0.0).any()):
        return 0.0
    ratio = float(last.sum() / before.sum())
    return math.inf if ratio >= 1.0 else _relative_rms(last, light) * ratio / (1.0 - ratio)


def _relative_rms(difference: Tensor, light: Tensor) -> float:
    """Root mean square of differences relative to the light, over what is not dark."""
    bright = light > 0.0
    if not bool(bright.any()):
        return 0.0
    return float((difference[bright] / light[bright]).square().mean().sqrt())
