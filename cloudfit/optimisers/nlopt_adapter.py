"""The methods of NLopt behind the `Minimiser` protocol; the only file that knows nlopt.

What the adapter guards against: NLopt reuses the buffer of x; DIRECT_L raises and others stall or crash on NaN; some methods
evaluate beyond `maxeval` (CRS2 finishes its whole first population after a request to stop); ISRES, ESCH and DIRECT
never stop of themselves; the random numbers are one global stream. So every point is copied and counted by our log,
the log answers with finite losses, nothing is evaluated once the run is over, and the incumbent is ours.
"""

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import nlopt
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cloudfit.optimisers.base import (
    PENALTY,
    Budget,
    EvaluationLog,
    Objective,
    OptimiserResult,
    Progress,
    StopReason,
    check_start,
    run_logged,
    seeded_generator,
)
from render.errors import ParameterError

NLOPT_ALGORITHMS: Mapping[str, int] = MappingProxyType(
    {
        "crs2_lm": nlopt.GN_CRS2_LM,
        "direct": nlopt.GN_DIRECT,
        "direct_l": nlopt.GN_DIRECT_L,
        "isres": nlopt.GN_ISRES,
        "esch": nlopt.GN_ESCH,
        "sbplx": nlopt.LN_SBPLX,
        "bobyqa": nlopt.LN_BOBYQA,
        "cobyla": nlopt.LN_COBYLA,
        "nelder_mead": nlopt.LN_NELDERMEAD,
    }
)


@dataclass(frozen=True)
class NloptMinimiser:
    """One sequential method of NLopt: every iteration is one evaluation.

    Args:
        algorithm: one of `NLOPT_ALGORITHMS`.
        tolerance: step in every parameter of the unit cube below which a local method, or CRS2, has converged.
        initial_step: first step of a local method in the unit cube.
        largest_evaluations: limit of a run whose budget has none, because some methods never stop.

    Raises:
        ParameterError: when there is no such algorithm or a number is not positive.
    """

    algorithm: str
    tolerance: float = 1e-4
    initial_step: float = 0.2
    largest_evaluations: int = 5000

    def __post_init__(self) -> None:
        if self.algorithm not in NLOPT_ALGORITHMS:
            raise ParameterError(f"expected an algorithm out of {', '.join(NLOPT_ALGORITHMS)}, got {self.algorithm!r}")
        if not (self.tolerance > 0 and 0 < self.initial_step <= 1 and self.largest_evaluations > 0):
            raise ParameterError(
                "expected tolerance > 0, initial_step in 0..1 and largest_evaluations > 0, got "
                f"{self.tolerance}, {self.initial_step} and {self.largest_evaluations}"
            )

    def minimise(
        self,
        objective: Objective,
        dimension: int,
        budget: Budget,
        seed: int,
        on_progress: Progress | None = None,
        start: Tensor | None = None,
    ) -> OptimiserResult:
        """Search the unit cube; see `Minimiser`. Without a start, one is drawn at random."""
        generator = seeded_generator(seed)
        point = check_start(start, dimension)
        if point is None:
            point = torch.rand(dimension, generator=generator, dtype=torch.float64)
        if budget.evaluations is None:
            budget = replace(budget, evaluations=self.largest_evaluations)

        def search(log: EvaluationLog) -> StopReason:
            return self._search(log, point.numpy(), seed)

        return run_logged(search, objective, dimension, budget, on_progress)

    def _search(self, log: EvaluationLog, start: NDArray[np.float64], seed: int) -> StopReason:
        solver = nlopt.opt(NLOPT_ALGORITHMS[self.algorithm], log.dimension)
        solver.set_lower_bounds(np.zeros(log.dimension))
        solver.set_upper_bounds(np.ones(log.dimension))
        solver.set_xtol_abs(self.tolerance)
        solver.set_initial_step(self.initial_step)
        ending: list[BaseException] = []

        def evaluate(x: NDArray[np.float64], gradient: NDArray[np.float64]) -> float:
            if not ending:
                try:
                    return float(log.evaluate(torch.from_numpy(x.copy())[None])[0])
                except BaseException as end:
                    # Nothing is raised through NLopt's own code: it is asked to stop, and the reason raised below.
                    ending.append(end)
                    solver.force_stop()
            return PENALTY

        solver.set_min_objective(evaluate)
        nlopt.srand(seed)
        # Roundoff limits the steps of a local method: as converged as it can be.
        with contextlib.suppress(nlopt.ForcedStop, nlopt.RoundoffLimited):
            solver.optimize(start)
        if ending:
            raise ending[0]
        return StopReason.CONVERGED
