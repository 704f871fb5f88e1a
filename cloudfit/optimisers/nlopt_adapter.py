"""The methods of NLopt behind the `Minimiser` protocol.

What the adapter guards against: NLopt reuses the buffer of x; on NaN or infinity DIRECT_L raises, MLSL returns NaN and AGS
crashes; ORIG_DIRECT_L crashes when its first evaluation asks it to stop; some methods evaluate beyond `maxeval` (CRS2
finishes its whole first population after a request to stop, ORIG_DIRECT_L its whole division); MLSL, ISRES, ESCH and
DIRECT never stop of themselves; the random numbers are one global stream. So every point is copied and counted by our
log, the log answers with finite losses, nothing is evaluated once the run is over, the incumbent is ours, and methods
that can crash work in a process of their own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cloudfit.optimisers.base import (
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
from cloudfit.optimisers.nlopt_solver import ALGORITHMS, Search, solve, solve_apart
from render.errors import ParameterError

NEED_A_LOCAL = ("mlsl", "mlsl_lds")

LOCAL = ("sbplx", "bobyqa", "cobyla", "nelder_mead")

CRASH_PRONE = ("ags", "orig_direct_l")
"""Methods that run in a process of their own: AGS crashes on NaN, ORIG_DIRECT_L when its first evaluation asks it to stop."""

DETERMINISTIC = ("ags", "direct", "direct_l", "orig_direct_l")
"""Methods that use neither a start nor random numbers."""

MOST_PARAMETERS: Mapping[str, int] = MappingProxyType({"ags": 10})
"""AGS follows one curve through the cube, which NLopt resolves in no more dimensions; above 5 it finds little."""

NLOPT_ALGORITHMS: tuple[str, ...] = tuple(name for name in ALGORITHMS if name not in NEED_A_LOCAL)
"""Those that work alone."""


@dataclass(frozen=True)
class NloptMinimiser:
    """One sequential method of NLopt: every iteration is one evaluation.

    Args:
        algorithm: one of `NLOPT_ALGORITHMS`, or "mlsl" or "mlsl_lds", which start a local method from many points.
        local: that method, one of `LOCAL`; for the two alone.
        tolerance: step in every parameter of the unit cube below which a local method, or CRS2, has converged.
        local_tolerance: the same for the method inside of MLSL, which starts it often.
        initial_step: first step of a local method in the unit cube.
        largest_evaluations: limit of a run whose budget has none, because some methods never stop.

    Raises:
        ParameterError: when there is no such algorithm or a number is not positive.
    """

    algorithm: str
    local: str | None = None
    tolerance: float = 1e-4
    local_tolerance: float = 1e-3
    initial_step: float = 0.2
    largest_evaluations: int = 5000

    def __post_init__(self) -> None:
        if self.algorithm not in ALGORITHMS:
            raise ParameterError(f"expected an algorithm out of {', '.join(ALGORITHMS)}, got {self.algorithm!r}")
        if self.local not in (LOCAL if self.algorithm in NEED_A_LOCAL else (None,)):
            raise ParameterError(
                f"expected a local method out of {', '.join(LOCAL)} for {' and '.join(NEED_A_LOCAL)} and none for others, "
                f"got {self.local!r} for {self.algorithm!r}"
            )
        positive = min(self.tolerance, self.local_tolerance, self.initial_step, self.largest_evaluations) > 0
        if not (positive and self.initial_step <= 1):
            raise ParameterError(
                "expected tolerance > 0, local_tolerance > 0, initial_step in 0..1 and largest_evaluations > 0, got "
                f"{self.tolerance}, {self.local_tolerance}, {self.initial_step} and {self.largest_evaluations}"
            )

    @property
    def is_deterministic(self) -> bool:
        """Whether every seed gives the same run."""
        return self.algorithm in DETERMINISTIC

    def minimise(
        self,
        objective: Objective,
        dimension: int,
        budget: Budget,
        seed: int,
        on_progress: Progress | None = None,
        start: Tensor | None = None,
    ) -> OptimiserResult:
        """Search the unit cube; see `Minimiser`. Without a start, one is drawn at random.

        Raises:
            ParameterError: when the method cannot search so many parameters.
        """
        most = MOST_PARAMETERS.get(self.algorithm, dimension)
        if dimension > most:
            raise ParameterError(f"{self.algorithm} searches at most {most} parameters, got {dimension}")
        generator = seeded_generator(seed)
        point = check_start(start, dimension)
        if point is None:
            point = torch.rand(dimension, generator=generator, dtype=torch.float64)
        if budget.evaluations is None:
            budget = replace(budget, evaluations=self.largest_evaluations)
        search = Search(
            algorithm=self.algorithm,
            local=self.local,
            start=tuple(point.tolist()),
            tolerance=self.tolerance,
            local_tolerance=self.local_tolerance,
            initial_step=self.initial_step,
            # One more than the log allows, so that it is the log that ends the run and gives the reason.
            evaluations=(budget.evaluations or self.largest_evaluations) + 1,
            seed=seed,
        )
        return run_logged(lambda log: self._search(log, search), objective, dimension, budget, on_progress)

    def _search(self, log: EvaluationLog, search: Search) -> StopReason:
        ending: list[BaseException] = []

        def evaluate(x: NDArray[np.float64]) -> float | None:
            try:
                return float(log.evaluate(torch.tensor(x)[None])[0])
            except BaseException as end:
                # Nothing is raised through NLopt's own code: it is asked to stop, and the reason raised below.
                ending.append(end)
                return None

        run = solve_apart if self.algorithm in CRASH_PRONE else solve
        run(search, evaluate)
        if ending:
            raise ending[0]
        return StopReason.CONVERGED
