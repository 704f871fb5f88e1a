"""High scattering orders, carried from one order to the next on a lattice instead of followed along paths.

The source of order k + 1 at a point x is what flights from there gather of order k,

    J_(k+1)(x, v) = integral of p(v . d) L_k(x, d) dd,        L_k(x, d) = mean of J_k(x', d) over the flights from x along d,

and a flight ends at x' with the density s rho exp(-s u), or leaves the volume. One flight a direction is drawn at every point of a lattice
(`light_lattice`), and serves all orders and asymmetries: after k orders a value is the mean over directions^k paths, where a path
tracer has one. The angular part is kept in harmonics, of which scattering multiplies those of degree l by g^l.

Three things keep the error from growing with the order. Interpolation neither spreads nor loses light (`LightLattice.sharpen`). The
distances of the flights of one point are a low-discrepancy sequence over its directions. And orders take turns between sets of
directions that are turned at random: with one set, what it misses in one order it misses in all, and the largest eigenvalue of a disturbed
operator lies too high on average; at g = 0.6 and depth 15, orders 19 to 34 came out 11 per cent too bright with 72 directions, and 1 per
cent with two sets of 32; at g = 0.85 and depth 60 two sets leave 9 per cent, four 3.

What truncated harmonics cannot hold, a forward lobe, has become round after some orders: k scatterings have the asymmetry g^k. So
paths are followed up to an order that depends on g (`last_traced_orders`), and those beyond are carried. The method is that of
successive orders in spherical harmonics and discrete ordinates (Evans 1998, "The spherical harmonics discrete ordinate method for
three-dimensional atmospheric radiative transfer"), with drawn flights for its short characteristics.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from precompute.direction_sets import DirectionSet, turned_directions
from precompute.drawn_flights import DrawnFlights, draw_flights, locate_ends
from precompute.in_threads import map_in_threads
from precompute.light_lattice import LightLattice, light_lattice_over, spacing_for
from precompute.order_plan import SEPARATE_ORDERS, OrderPlan, place_knots
from precompute.order_tail import HISTORY, extrapolate_orders
from precompute.path_sampler import EVERY_ORDER
from precompute.view import View
from render.density_grid import DensityGrid
from render.free_flight import march_to_sun
from render.fused import fused_loops_wanted
from render.interpolation import cubic_weights
from render.random_streams import counter_keys, counter_uniform, stream_number
from render.spherical_harmonics import degrees_of_harmonics, evaluate_harmonics

HIGH_ORDER, HIGH_DEGREE = 10, 3
"""Order beyond which light has become round enough for harmonics up to that degree, and for half of the directions at a time."""

SHARPENED_DEGREE = 1
"""Harmonics up to which light is sharpened: what keeps the amount and the flow of light. At higher degrees it let a pattern of the lattice
grow at asymmetries of 0.9, until by the 66th order a quarter of the light was that."""

CELL_DEPTH = 1.4
"""Optical depth of the densest cell between lattice points that is aimed at."""

STAGGER = (-0.25, 0.25)
"""Shifts of the lattices of the two halves in spacings: points of one lie in the middle of the other's cells, so that the halves differ by
what a lattice misses as well as by noise, and their mean misses less."""

CARRIED_ASYMMETRIES = 8
"""At most; others are interpolated between them. Eight numbers of 32 bits fill a vector register."""

FEATURE_STRIDE = 2
"""Of the carried asymmetries that features are made of."""

ROUND = 0.015
"""Share |g|^(k (degree + 1)) of what the harmonics leave out of order k, from which on that order is carried."""

LAST_CARRIED = 50
"""Order that light is carried to; those beyond follow from the ones before, see `order_tail`."""

FAINT = 1e-4
"""Share of the light so far that an order adds below which none is carried further."""

AT_ONCE = 25
"""Directions that light is carried along at once: matrix products of fewer wait for memory, more would take much of it."""


CarryingLattices = tuple[LightLattice, LightLattice]
"""Of both halves."""


@dataclass(frozen=True)
class CarryingEffort:
    """How finely light is carried.

    Args:
        degree: of the harmonics.
        sets: of directions that orders take turns with, in each half.
        points: of the lattice, at most, about.
        coarsest: spacing of the lattice over the longest edge of the volume, however thin the cloud.
        deepest_cell: optical depth of the densest cell beyond which paths are better.
    """

    degree: int
    sets: int
    points: int
    coarsest: float
    deepest_cell: float


@dataclass(frozen=True, eq=False)
class CarriedOrders:
    """The source of the orders that were carried.

    Args:
        lattices: of each half's points.
        degree: of the harmonics.
        source: J of each half, sharpened, `(extinction, point, knot, asymmetry)` [1/sr], for unit sunlight and albedo one.
        features: of each half, J of the orders two to four at some asymmetries, sharpened, `(extinction, point, feature)`: too rough to be
            taken for the orders that are traced, but nearly without noise.
        overlap: of each half, J of the order four, which paths trace at every asymmetry, sharpened `(extinction, point, asymmetry)` [1/sr].
    """

    lattices: CarryingLattices
    degree: int
    source: tuple[Tensor, Tensor]
    features: tuple[Tensor, Tensor]
    overlap: tuple[Tensor, Tensor]

    @property
    def points(self) -> int:
        """Of both lattices together."""
        return sum(len(lattice.numbers) for lattice in self.lattices)

    def at(self, node: int, position: Tensor) -> Tensor:
        """J at positions `(position, 3)` [m] at one extinction: `(position, half, knot, asymmetry)`."""
        found = position.new_empty(len(position), 2, *self.source[0].shape[2:])
        for half, (lattice, source) in enumerate(zip(self.lattices, self.source, strict=True)):
            found[:, half] = lattice.interpolate(source[node].flatten(1), position).unflatten(1, found.shape[2:])
        return found

    def features_at(self, node: int, position: Tensor) -> Tensor:
        """Features at positions `(position, 3)` [m] at one extinction, means of both halves `(position, feature)`."""
        return self._mean_at(self.features, node, position)

    def overlap_at(self, node: int, position: Tensor) -> Tensor:
        """The overlap at positions `(position, 3)` [m] at one extinction, mean of both halves `(position, asymmetry)`."""
        return self._mean_at(self.overlap, node, position)

    def _mean_at(self, halves: tuple[Tensor, Tensor], node: int, position: Tensor) -> Tensor:
        first, second = zip(self.lattices, halves, strict=True)
        return 0.5 * (first[0].interpolate(first[1][node], position) + second[0].interpolate(second[1][node], position))


def last_traced_orders(asymmetry: Tensor, degree: int) -> Tensor:
    """Last order for which a forward lobe needs paths, for each asymmetry: knots of `plan_orders`, at least the last order of its own.

    Args:
        asymmetry: `(asymmetry,)`.
        degree: of the harmonics that carry the others.
    """
    size = asymmetry.double().abs().clamp(1e-6, 1.0 - 1e-6)
    needed = (math.log(ROUND) / size.log() / (degree + 1)).ceil().long()
    knots = torch.tensor([knot for knot in place_knots(EVERY_ORDER) if knot >= SEPARATE_ORDERS])
    return knots[torch.searchsorted(knots, needed).clamp(max=len(knots) - 1)]


def carried_asymmetries(asymmetry: Tensor) -> Tensor:
    """Those of the asymmetries that light is carried at: where they lie closest in ln(1 - |g|), one after the other is left out."""
    kept = asymmetry
    while len(kept) > CARRIED_ASYMMETRIES:
        place = -torch.log1p(-kept.double().abs()) * kept.sign()
        left_out = 1 + int((place[2:] - place[:-2]).argmin())
        kept = torch.cat([kept[:left_out], kept[left_out + 1 :]])
    return kept


def resolving_lattices(grid: DensityGrid, extinction: float, effort: CarryingEffort) -> CarryingLattices | None:
    """Lattices that resolve the mean free paths at an extinction [1/m]; None where they would take too many points."""
    coarsest = effort.coarsest * max(grid.density.shape)
    spacing = min(coarsest, spacing_for(grid, extinction, CELL_DEPTH))
    first, second = (light_lattice_over(grid, spacing, effort.points, shift) for shift in STAGGER)
    cell_depth = extinction * grid.maximum * float(first.lattice.spacing.max())
    return (first, second) if cell_depth <= effort.deepest_cell else None


def carry_orders(
    view: View,
    lattices: CarryingLattices,
    asymmetry: Tensor,
    extinction: Tensor,
    plan: OrderPlan,
    effort: CarryingEffort,
    step: float,
    seed: int,
    on_progress: Callable[[float], None] = lambda share: None,
) -> CarriedOrders:
    """The source of all orders beyond `last_traced_orders`, in two independent halves.

    Args:
        view: volume, camera and sun.
        lattices: to carry each half on.
        asymmetry: nodes `(asymmetry,)`.
        extinction: nodes `(extinction,)` [1/m].
        plan: all orders and their images.
        effort: degree of the harmonics, and sets of directions.
        step: longest marching step in voxels.
        seed: of the random numbers.
        on_progress: called with the share that is done.
    """
    count, degree = effort.sets, effort.degree
    # Keys of zero would name the streams of source tables, which have the seed alone.
    keys = [
        counter_keys(stream_number(seed, 1 + half), torch.arange(count + len(lattice.numbers)))
        for half, lattice in enumerate(lattices)
    ]
    draws = [
        counter_uniform(of_half[:count, None].expand(-1, 3), torch.arange(3).expand(count, -1)) for of_half in keys
    ]
    sets = [[turned_directions(degree, turn) for turn in of_half] for of_half in draws]

    def draw(piece: int) -> list[DrawnFlights]:
        half, turn = divmod(piece, count)
        shift = counter_uniform(keys[half][count:], turn)
        return draw_flights(view.grid, lattices[half], sets[half][turn], extinction, shift, step)

    flights = map_in_threads(draw, 2 * count, lambda done: on_progress(0.3 * done / (2 * count)))

    def carry(piece: int) -> tuple[Tensor, Tensor, Tensor]:
        node, half = divmod(piece, 2)
        turns = [_Turn(sets[half][turn], flights[half * count + turn][node]) for turn in range(count)]
        lattice = lattices[half]
        carrier = _Carrier(view, lattice, float(extinction[node]), step, turns)
        source, low, overlap = carrier.carry(asymmetry, plan)
        return lattice.sharpen(source.flatten(1)).view_as(source), lattice.sharpen(low), lattice.sharpen(overlap)

    nodes = len(extinction)
    pieces = map_in_threads(carry, 2 * nodes, lambda done: on_progress(0.3 + 0.35 * done / nodes))
    halves = [[torch.stack(ones) for ones in zip(*pieces[half::2], strict=True)] for half in range(2)]
    source, features, overlap = zip(*halves, strict=True)
    return CarriedOrders(lattices, degree, source, features, overlap)


@dataclass(frozen=True, eq=False)
class _Turn:
    """Directions, and flights along them from every point, that serve one order after the other."""

    directions: DirectionSet
    flights: DrawnFlights

    def halves(self, degree: int) -> "tuple[_Turn, _Turn]":
        """Two turns with half of the directions each, and harmonics up to a smaller degree."""
        first, second = self.directions.halves(degree)
        rows = slice(None, len(first.direction)), slice(len(first.direction), None)
        return _Turn(first, self.flights.part(rows[0])), _Turn(second, self.flights.part(rows[1]))


class _Carrier:
    """Carries orders at one extinction."""

    def __init__(self, view: View, lattice: LightLattice, extinction: float, step: float, turns: list[_Turn]) -> None:
        self._view, self._lattice, self._extinction, self._step = view, lattice, extinction, step
        self._turns = turns

    def carry(self, asymmetry: Tensor, plan: OrderPlan) -> tuple[Tensor, Tensor, Tensor]:
        """J of the orders beyond those traced `(point, knot, asymmetry)`; features and overlap from those below, see `CarriedOrders`."""
        degree, view, position = self._turns[0].directions.degree, self._view, self._lattice.positions
        traced = last_traced_orders(asymmetry, degree)
        carried = carried_asymmetries(asymmetry)
        between = cubic_weights(carried, asymmetry).T
        damping = carried ** degrees_of_harmonics(degree, odd=True)[:, None].float()
        towards = evaluate_harmonics(view.camera.directions_at(position).double(), degree).float().T
        sun = evaluate_harmonics(view.sun.double(), degree).float()
        length = march_to_sun(view.grid, position, view.sun, torch.tensor(self._extinction), self._step)
        light = (sun[:, None] * damping)[:, None] * torch.exp(-self._extinction * length)[:, None]
        space, towards_camera = _Space.like(light), torch.empty_like(light[0])
        found = torch.zeros(len(plan.knots), len(position), len(asymmetry))
        energy, low, turns, history = list[Tensor](), list[Tensor](), self._turns, list[Tensor]()
        last = min(plan.largest_order, LAST_CARRIED)
        for order in range(2, last + 1):
            if order == HIGH_ORDER + 1 and degree > HIGH_DEGREE:
                kept = degrees_of_harmonics(degree, odd=True) <= HIGH_DEGREE
                light, damping, towards, space = light[kept], damping[kept], towards[kept], space.part(kept)
                turns = [half for turn in turns for half in turn.halves(HIGH_DEGREE)]
            self._scatter(light, damping, turns[order % len(turns)], space)
            torch.mul(light[0], towards[0, :, None], out=towards_camera)
            for one, harmonic in zip(light[1:], towards[1:], strict=True):
                towards_camera.addcmul_(one, harmonic[:, None])
            if order <= SEPARATE_ORDERS:
                low.append(towards_camera[:, ::FEATURE_STRIDE].clone())
            if order == SEPARATE_ORDERS:
                overlap = towards_camera @ between
            history = [*history[1 - HISTORY :], towards_camera.clone()]
            energy.append(towards_camera.mean(0, dtype=torch.float64).abs())
            shares = plan.shares[order - 2].float()[:, None] * (order > traced)
            if bool(shares.any()):
                source = towards_camera @ between
            for knot in torch.nonzero(shares.any(1)).flatten().tolist():
                found[knot].addcmul_(source, shares[knot])
            faint = energy[-1] <= FAINT * torch.stack(energy).sum(0)
            if order > traced.max() and bool(faint.all()):
                break
        else:
            del light, space  # as much memory as the rest needs
            # Faint light is noise of either sign, from which nothing follows.
            self._extend(found, history, between * ~faint[:, None], traced, last, plan)
        return found.movedim(0, 1).contiguous(), torch.cat(low, dim=1), overlap

    @staticmethod
    def _extend(
        found: Tensor, history: list[Tensor], between: Tensor, traced: Tensor, last: int, plan: OrderPlan
    ) -> None:
        """Add the orders beyond the last that was carried, where they are not traced.

        Args:
            found: J `(knot, point, asymmetry)`, changed in place.
            history: J at the asymmetries that are carried, of the last orders `(point, carried)`.
            between: from those to all asymmetries `(carried, asymmetry)`.
            traced: last orders that are `(asymmetry,)`.
            last: order that was carried.
            plan: of all orders.
        """
        after = traced.clamp(min=last)
        for order in after.unique().tolist():
            members = torch.nonzero(after == order).flatten()
            missing = plan.shares[last - 1 :].clone()
            missing[: order - last] = 0.0
            if bool(missing.any()):
                found[:, :, members] += extrapolate_orders(history, missing) @ between[:, members]

    def _scatter(self, light: Tensor, damping: Tensor, turn: _Turn, space: "_Space") -> None:
        """The next order of light `(harmonic, point, asymmetry)`, in its place."""
        directions, flights = turn.directions, turn.flights
        fused = fused_loops_wanted(light)
        sharpen, gather = (_sharpen_fused, _gather_fused) if fused else (_sharpen, _gather)
        space.sharp.copy_(light)
        flow = torch.nonzero(degrees_of_harmonics(directions.degree, odd=True) <= SHARPENED_DEGREE).flatten()
        for number in flow.tolist():
            one = slice(number, number + 1)
            sharpen(self._lattice, light[one], flights.spread, space.sharp[one])
        light.zero_()
        for first in range(0, len(directions.direction), AT_ONCE):
            block = slice(first, first + AT_ONCE)
            harmonics, projection = directions.harmonics[block], directions.projection[:, block]
            along, brought = space.along[: len(harmonics)], space.brought[: len(harmonics)]
            torch.mm(harmonics, space.sharp.flatten(1), out=along.flatten(1))
            gather(self._lattice, along, flights.part(block), brought)
            light.flatten(1).addmm_(projection, brought.flatten(1))
        light.mul_(damping[:, None])


@dataclass(frozen=True, eq=False)
class _Space:
    """Memory for one order: sharpened light `(harmonic, point, asymmetry)`, light along some directions, what flights bring of it."""

    sharp: Tensor
    along: Tensor
    brought: Tensor

    @classmethod
    def like(cls, light: Tensor) -> "_Space":
        along = light.new_empty(AT_ONCE, *light.shape[1:])
        return cls(torch.empty_like(light), along, torch.empty_like(along))

    def part(self, harmonics: Tensor) -> "_Space":
        """For some of the harmonics only."""
        return _Space(self.sharp[: int(harmonics.sum())], self.along, self.brought)


def _sharpen(lattice: LightLattice, light: Tensor, spread: Tensor, sharp: Tensor) -> None:
    for values, result in zip(light, sharp, strict=True):
        result.copy_(lattice.sharpen(values, spread))


def _sharpen_fused(lattice: LightLattice, light: Tensor, spread: Tensor, sharp: Tensor) -> None:
    from precompute.fused_gather import sharpen_light  # needs numba

    sharpen_light(light, lattice.neighbours, spread, sharp)


def _gather(lattice: LightLattice, along: Tensor, flights: DrawnFlights, brought: Tensor) -> None:
    """Values where the flights end."""
    for values, cell, fraction, result in zip(along, flights.cell, flights.fraction, brought, strict=True):
        numbers, weights = lattice.corners(locate_ends(lattice.lattice, cell.clamp(min=0), fraction))
        weights = weights * (cell >= 0)[:, None]
        result.copy_(embedding_bag(numbers, values, per_sample_weights=weights, mode="sum"))


def _gather_fused(lattice: LightLattice, along: Tensor, flights: DrawnFlights, brought: Tensor) -> None:
    from precompute.fused_gather import gather_flights  # needs numba

    counts = torch.tensor(lattice.lattice.counts)
    gather_flights(along, lattice.entry, counts, flights.cell, flights.fraction, brought)
