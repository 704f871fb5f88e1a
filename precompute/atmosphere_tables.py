"""Builds the tables of an atmosphere, one order of scattering after the other.

The stages are those of Bruneton & Neyret 2008, algorithm 4.1, in the order of Bruneton 2017. After each order there is a state from which
the next one follows, and tables of the light up to there can be had from any of them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from precompute.atmosphere.density_table import build_scattering_density
from precompute.atmosphere.irradiance import build_direct_irradiance, build_indirect_irradiance
from precompute.atmosphere.multiple_scattering import build_multiple_scattering
from precompute.atmosphere.quadratures import PARITY, Quadratures
from precompute.atmosphere.scattering_density import ScatteredOrder
from precompute.atmosphere.single_scattering import build_single_scattering
from precompute.atmosphere.transmittance import build_transmittance
from precompute.in_threads import map_in_threads
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.tables import DEFAULT_SIZES, AtmosphereTables, TableSizes, scattering_nodes
from render.errors import ParameterError
from render.rayleigh_phase import evaluate_rayleigh_phase

Progress = Callable[[str, float], None]
"""Called with the name of a stage and the share of it that is done."""

DTYPES = {"float64": torch.float64, "float32": torch.float32}
"""Types of the tables by name."""


@dataclass(frozen=True)
class TablePlan:
    """What tables are to be built; together with the atmosphere all that their numbers depend on.

    Args:
        sizes: nodes of each axis.
        orders: how often light may be scattered, at least 1.
        quadratures: rules of the integrals.
        precision: type in which tables are kept, a name of `DTYPES`. Geometry is float64 in either; with float32, tables take half
            the memory, not less time, and differ by less than 1e-6 of each table's largest value.

    Raises:
        ParameterError: for fewer than one order, or another type.
    """

    sizes: TableSizes = DEFAULT_SIZES
    orders: int = 4
    quadratures: Quadratures = PARITY
    precision: str = "float64"

    def __post_init__(self) -> None:
        if self.orders < 1:
            raise ParameterError(f"light must be scattered at least once, not {self.orders} times")
        if self.precision not in DTYPES:
            raise ParameterError(f"tables are kept as {' or '.join(DTYPES)}, not {self.precision!r}")


@dataclass(frozen=True, eq=False)
class OrderState:
    """Everything that the next order of scattering needs.

    Args:
        order: how often the light has been scattered so far.
        transmittance: table `(radius, view, wavelength)` [1].
        light: tables of this order alone, as those of `ScatteredOrder`.
        density: of the scattering that made this order [W/m^3/sr/nm]; None for the first.
        ground_irradiance: table of the order before, which the ground reflects into this one's successor [W/m^2/nm].
        irradiance: by the sky, all orders below this one `(radius, sun, wavelength)` [W/m^2/nm].
        scattering: all orders, as in `AtmosphereTables` [W/m^2/nm].
        single_mie: as in `AtmosphereTables` [W/m^2/nm].
    """

    order: int
    transmittance: Tensor
    light: tuple[Tensor, ...]
    density: Tensor | None
    ground_irradiance: Tensor
    irradiance: Tensor
    scattering: Tensor
    single_mie: Tensor

    def tables(self, atmosphere: AtmosphereParameters) -> AtmosphereTables:
        """Tables of light scattered up to this order."""
        return AtmosphereTables(
            atmosphere, self.transmittance, self.irradiance, self.scattering, self.single_mie, self.order
        )


def build_atmosphere_tables(
    atmosphere: AtmosphereParameters,
    plan: TablePlan | None = None,
    on_progress: Progress = lambda stage, share: None,
) -> AtmosphereTables:
    """Build all tables of an atmosphere.

    Args:
        atmosphere: the planet.
        plan: sizes, orders and quadratures; by default those of Bruneton's reference.
        on_progress: told what is being done.

    Returns:
        The tables.
    """
    plan = plan or TablePlan()
    state = build_first_order(atmosphere, plan, on_progress)
    while state.order < plan.orders:
        state = build_next_order(atmosphere, plan, state, on_progress)
    return state.tables(atmosphere)


def build_first_order(
    atmosphere: AtmosphereParameters, plan: TablePlan, on_progress: Progress = lambda stage, share: None
) -> OrderState:
    """Transmittance, direct irradiance and light scattered once; arguments as for `build_atmosphere_tables`."""
    sizes, rules, dtype = plan.sizes, plan.quadratures, DTYPES[plan.precision]
    transmittance = build_transmittance(atmosphere, sizes, rules.transmittance).to(dtype)
    on_progress("transmittance", 1.0)
    pieces = map_in_threads(
        lambda node: build_single_scattering(atmosphere, sizes, transmittance, node, rules.single_scattering),
        sizes.radii,
        lambda done: on_progress("order 1", done / sizes.radii),
    )
    by_air, by_aerosol = (torch.stack(tables).to(dtype) for tables in zip(*pieces, strict=True))
    direct = build_direct_irradiance(atmosphere, sizes, transmittance).to(dtype)
    return OrderState(
        order=1,
        transmittance=transmittance,
        light=(by_air, by_aerosol),
        density=None,
        ground_irradiance=direct,
        irradiance=torch.zeros_like(direct),
        scattering=by_air,
        single_mie=by_aerosol,
    )


def build_next_order(
    atmosphere: AtmosphereParameters,
    plan: TablePlan,
    state: OrderState,
    on_progress: Progress = lambda stage, share: None,
) -> OrderState:
    """Light scattered once more; arguments as for `build_atmosphere_tables`.

    What falls on the ground is that of the order before the last: light reaches the ground n - 2 times scattered, is reflected, and is
    scattered once more to count as n (the reflection itself is not counted as an order but takes the place of one).
    """
    sizes, rules, dtype = plan.sizes, plan.quadratures, DTYPES[plan.precision]
    before = ScatteredOrder(state.light, atmosphere.mie_asymmetry)
    name = f"order {state.order + 1}"
    steps = 2 * sizes.radii
    density = torch.stack(
        map_in_threads(
            lambda node: build_scattering_density(
                atmosphere,
                sizes,
                state.transmittance,
                before,
                state.ground_irradiance,
                node,
                rules.scattering_density,
            ),
            sizes.radii,
            lambda done: on_progress(name, done / steps),
        )
    ).to(dtype)
    fallen = build_indirect_irradiance(atmosphere, sizes, before, rules.irradiance).to(dtype)
    light = torch.stack(
        map_in_threads(
            lambda node: build_multiple_scattering(
                atmosphere, sizes, state.transmittance, density, node, rules.multiple_scattering
            ),
            sizes.radii,
            lambda done: on_progress(name, 0.5 + done / steps),
        )
    ).to(dtype)
    return OrderState(
        order=state.order + 1,
        transmittance=state.transmittance,
        light=(light,),
        density=density,
        ground_irradiance=fallen,
        irradiance=state.irradiance + fallen,
        scattering=state.scattering + light / _rayleigh_phase_at_nodes(atmosphere, sizes).to(dtype),
        single_mie=state.single_mie,
    )


def _rayleigh_phase_at_nodes(atmosphere: AtmosphereParameters, sizes: TableSizes) -> Tensor:
    """Rayleigh phase function `(radius, view, view_sun, sun, 1)` [1/sr] that tables of later orders are divided by."""
    angles = [scattering_nodes(atmosphere, sizes, node).cos_view_sun for node in range(sizes.radii)]
    return evaluate_rayleigh_phase(torch.stack(angles))[..., None]
