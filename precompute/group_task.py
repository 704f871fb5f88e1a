"""What a group of extinction nodes is made of, and how finely its rays and paths are cut."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from torch import Tensor

from precompute.carried_orders import (
    CarriedOrders,
    CarryingEffort,
    CarryingLattices,
    carry_orders,
    resolving_lattices,
)
from precompute.error_budget import Effort
from precompute.gather import Lattice
from precompute.order_plan import OrderPlan
from precompute.path_sampler import TableNodes, every_order
from precompute.source_points import SourceTable
from precompute.view import View

STEP_DEPTH = 0.5
"""Optical depth of a marching step in the densest voxel, within the bounds that follow."""

SMALLEST_STEP, LARGEST_STEP = 0.25, 1.0
"""Bounds of the marching step in voxels."""

SECTIONS_PER_STRATUM = 2
"""Single scattering is cut finer than the source points' strata: it has no noise to hide behind."""

SECTIONS_AT_ONE = 1.28
"""Sections times tolerance: 64 err by 0.4 % at optical depth 34 and 57 under a sun from behind, and the error falls about as they rise."""

THIN_DEPTH, FEWEST_STRATA = 2.0, 4
"""In groups thinner than this the number of strata falls with the root of the depth: where little is absorbed, little depends on where."""

THICK_DEPTH = 20.0
"""Largest optical depth from which on a group is thick."""

THIN_POINTS = 0.6
"""Share of the effort's source points that a group gets which is not thick: light varies little between them, and each has more paths."""

CARRIED_SETS = 4
"""Of directions, which orders take turns with. Two leave light at g = 0.85 and depth 60 up to 13 per cent too bright by order 66; six cost
more than they gain."""

CARRIED_POINTS, CARRIED_DEGREE = (0.23, 0.33), (5, 4)
"""Points of the lattice that light is carried on over source points, and degree of its harmonics, in a thin group and a thick one. A
thick cloud, whose light is round, needs points that resolve its free paths; a thin one, where light is scattered forward and leaves,
directions."""

LEAST_CARRIED, COARSEST_CARRIED, DEEPEST_CELL = 14_000, 1.0 / 32.0, 4.5
"""Points of that lattice, if the coarsest spacing does not need fewer; that spacing; and the cells beyond which paths are better."""

ROUGH_TOLERANCE = 0.05
"""Above it light is carried on few points, in few directions and with long steps, which still leaves less error than few paths do."""

ROUGH_POINTS, ROUGH_DEGREE, ROUGH_SETS, ROUGH_COARSEST, ROUGH_CELL, ROUGH_STEP = 8000, 2, 2, 1.0 / 20.0, 5.0, 2.0
"""What `CARRIED_POINTS` and the others are then, and the factor on the marching step."""

UNSEEN_ERROR, ROUGH_UNSEEN_ERROR = 1.3, 1.8
"""Error of a group over what halves and sharpening tell, and the same of a thick one for tolerances above `ROUGH_TOLERANCE`: both halves
miss the same between the points of their lattices. Measured against path-traced pixels of three clouds under two suns: 0.7 to 1.9, and
1.3 to 2.3. Neither more spread halves of carried light, which are smoothed the more, nor a lattice with a third of the points, which is
too far from converging, told it better."""

FEWEST_CARRIED = 18
"""Largest order from which on carrying pays: paths in thin clouds are short anyway."""

THINNEST_ANCHOR = 0.5
"""Largest optical depth below which no path is drawn: multiple scattering is a per-cent effect there, and reweighting reaches it."""


@dataclass(frozen=True, eq=False)
class GroupTask:
    """What a group is made of.

    Args:
        view: rays, volume and sun.
        asymmetry: nodes `(asymmetry,)`.
        extinction: nodes of the group `(extinction,)` [1/m].
        albedo: at which errors are judged `(albedo,)`.
        effort: work of this group.
        seed: of its random streams.
    """

    view: View
    asymmetry: Tensor
    extinction: Tensor
    albedo: Tensor
    effort: Effort
    seed: int

    @property
    def depth(self) -> float:
        """Largest optical depth of a ray."""
        return float(self.extinction[-1]) * self.view.largest_optical_length

    @property
    def thick(self) -> bool:
        """Whether light is round, and points lie about as close as density varies."""
        return self.depth >= THICK_DEPTH

    @property
    def step(self) -> float:
        """Marching step [voxel]."""
        grid = self.view.grid
        voxel_depth = float(self.extinction[-1]) * grid.maximum * float(grid.voxel_size.min())
        roughness = ROUGH_STEP if self._rough else 1.0
        return min(max(roughness * STEP_DEPTH / voxel_depth, roughness * SMALLEST_STEP), LARGEST_STEP)

    @property
    def strata(self) -> int:
        """Positions along a ray."""
        needed = math.ceil(self.effort.strata * min(1.0, math.sqrt(self.depth / THIN_DEPTH)))
        return min(self.effort.strata, max(FEWEST_STRATA, needed))

    @property
    def sections(self) -> int:
        """Pieces of a ray between which single scattering is integrated."""
        wanted = 0.0 if self.effort.tolerance is None else SECTIONS_AT_ONE / self.effort.tolerance
        return max(SECTIONS_PER_STRATUM * self.strata, math.ceil(wanted * min(1.0, math.sqrt(self.depth / THIN_DEPTH))))

    @property
    def unseen_error(self) -> float:
        """Error of the group over what can be told."""
        return ROUGH_UNSEEN_ERROR if self._rough and self.thick else UNSEEN_ERROR

    def points(self, effort: Effort) -> int:
        """Source points that an effort gives the group."""
        return effort.points if self.thick else round(THIN_POINTS * effort.points)

    def nodes(self, last_order: Callable[[Tensor], Tensor] = every_order) -> TableNodes:
        """Nodes and anchors of the paths, and the last order that they trace at each asymmetry."""
        anchors = self.extinction[self.extinction * self.view.largest_optical_length >= THINNEST_ANCHOR]
        thick = anchors if len(anchors) else self.extinction[-1:]
        return TableNodes(self.asymmetry, self.extinction, self.asymmetry, thick, last_order)

    def source_table(self, lattice: Lattice, plan: OrderPlan, nodes: TableNodes, stream: int) -> SourceTable:
        """Empty table of the source on a lattice; `stream` tells its random numbers from those of the group's other tables."""
        view = self.view
        return SourceTable(view.grid, view.camera, view.sun, lattice, nodes, plan, self.step, 2 * self.seed + stream)

    def lattices(self, largest_order: int, points: int) -> CarryingLattices | None:
        """What high orders are carried on, to suit so many source points; None where it is too coarse, or not worth it."""
        if largest_order < FEWEST_CARRIED:
            return None
        return resolving_lattices(self.view.grid, float(self.extinction[-1]), self._carrying_effort(points))

    @cached_property
    def thick_lattices(self) -> CarryingLattices | None:
        """What all orders are carried on in a thick group, where it is fine enough."""
        return self.lattices(self.effort.orders, self.points(self.effort)) if self.thick else None

    def carry(
        self, plan: OrderPlan, lattices: CarryingLattices, points: int, on_progress: Callable[[float], None]
    ) -> CarriedOrders:
        """High orders, carried on lattices that suit so many source points."""
        nodes, effort = (self.asymmetry, self.extinction), self._carrying_effort(points)
        return carry_orders(self.view, lattices, *nodes, plan, effort, self.step, self.seed, on_progress)

    @property
    def _rough(self) -> bool:
        return self.effort.tolerance is not None and self.effort.tolerance > ROUGH_TOLERANCE

    def _carrying_effort(self, points: int) -> CarryingEffort:
        if self._rough:
            return CarryingEffort(ROUGH_DEGREE, ROUGH_SETS, ROUGH_POINTS, ROUGH_COARSEST, ROUGH_CELL)
        wanted = max(LEAST_CARRIED, round(CARRIED_POINTS[self.thick] * points))
        return CarryingEffort(CARRIED_DEGREE[self.thick], CARRIED_SETS, wanted, COARSEST_CARRIED, DEEPEST_CELL)
